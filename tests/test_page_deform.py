"""The page's own deformers and gauge, run by node, against the kernels and `deform.quality`."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import skins
import vitruvian as vt
from capsules import capsule_body, stride
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Body, Morph, Weights
from vitruvian.deform.deformer import NAMES, deformer
from vitruvian.deform.quality import Gauge, turned
from vitruvian.modeling.tuning import tuned
from vitruvian.show.actors import actors_of, mesh_message
from vitruvian.show.comparison import default_pose
from vitruvian.show.server import FOLDER

JOB = Path(__file__).parent / "page_deform.mjs"
MEASURED = ("linear", "log", "contours", "hand")
FINGERS = (
    "l_metacarpophalangeal_2",
    "l_carpal_proximal_interphalangeal_2",
    "r_metacarpophalangeal_3",
    "l_carpometacarpal_5",
)


def posed(body: Body, pose) -> np.ndarray:
    rotation = body.skeleton.rotation.copy()
    for joint, value in pose.items():
        rotation[body.skeleton.index[joint]] = from_axis_angle(np.asarray(value, float))
    return joint_matrices(replace(body.skeleton, rotation=rotation))[0]


def in_page(tmp_path, cases) -> list[dict]:
    """What node answers for (body, matrices (J,4,4), names, joints, further fields of the job)."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is missing: install Debian's `nodejs`")
    jobs = []
    for i, (body, matrices, names, joints, more) in enumerate(cases):
        (tmp_path / f"{i}.mesh").write_bytes(mesh_message(actors_of([body])[0]))
        matrices[:, :3].astype(np.float32).tofile(tmp_path / f"{i}.pose")
        index = None if joints is None else [body.skeleton.index[j] for j in joints]
        files = {"mesh": str(tmp_path / f"{i}.mesh"), "pose": str(tmp_path / f"{i}.pose")}
        jobs.append(files | {"names": list(names), "joints": index} | more)
    (tmp_path / "jobs.json").write_text(json.dumps(jobs))
    run = subprocess.run([node, JOB, FOLDER, tmp_path / "jobs.json"], capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    answers = json.loads(run.stdout)
    for job, answer in zip(jobs, answers):
        for name, found in answer.items():
            if found is not None:
                found |= {"points": floats(job["mesh"], name)}
                found |= {"some": floats(job["mesh"], f"{name}.some")} if "some" in job else {}
    return answers


def floats(mesh: str, name: str) -> np.ndarray:
    return np.fromfile(f"{mesh}.{name}", np.float32).reshape(-1, 3)


@pytest.fixture(scope="module")
def people():
    """The built-in person with hands in a hard pose, and the same person in contours."""
    humanoid = vt.person(loa=4, outfit="body suit", hair="none")
    changes = {f"l_{part}_def": {"recentre": 1, "bulge": 0.2} for part in ("thigh", "forearm")}
    sliced = tuned(vt.contours(humanoid, tilt=0.5), changes)
    bodies = [vt.pack(humanoid), vt.pack(sliced)]
    pose = default_pose(bodies[0].skeleton) | {f: [0, 0, 1, 0.9] for f in FINGERS}
    return [(body, posed(body, pose)) for body in bodies]


def test_every_deformer_of_the_page_is_the_kernels_and_so_are_its_numbers(people, tmp_path) -> None:
    chosen = [list(turned(body.skeleton, m))[:8] for body, m in people]
    some = list(range(0, 10000, 89))
    cases = [
        (body, m, NAMES, joints, {"some": some, "measured": MEASURED}) for (body, m), joints in zip(people, chosen)
    ]
    answers = in_page(tmp_path, cases)
    assert answers[0]["contours"] is None and answers[1]["contours"] is not None
    for (body, matrices), joints, answer in zip(people, chosen, answers):
        gauge = Gauge(body, joints)
        for name in NAMES:
            if answer[name] is None:
                continue
            wanted = deformer(name, body)(matrices)
            found = answer[name]["points"]
            assert np.abs(found - wanted).max() < 1e-5, name
            for s in body.contours if name == "contours" else ():
                assert np.abs(found[s.vertices] - wanted[s.vertices]).max() < 1e-6, s.name
            np.testing.assert_array_equal(answer[name]["some"], found[some])  # a part of it
            if name not in MEASURED:
                continue
            report = gauge.measure(wanted, matrices)
            assert set(answer[name]["quality"]["joints"]) == set(report.joints)
            pairs = [(report.whole, answer[name]["quality"]["whole"])]
            pairs += [(q, answer[name]["quality"]["joints"][j]) for j, q in report.joints.items()]
            for ours, theirs in pairs:
                for field, value in ours.document().items():
                    if field == "folds":
                        assert abs(theirs[field] - value) <= 2  # a triangle that stands upright
                    elif value is not None and field != "stretch":  # an edge of micrometres tells little in float32
                        assert theirs[field] == pytest.approx(value, rel=1e-3, abs=1e-4), (name, field)


def test_scaled_joints_bindings_and_displacers_in_the_page(tmp_path) -> None:
    body = capsule_body(vertices=900)
    n = len(body.skeleton)
    scale = np.ones((n, 3))
    scale[6], scale[4] = [1.2, 0.8, 1.1], [1.1, 1.1, 1.1]
    rest = body.skin.rest.astype(np.float32).astype(float)  # what lies at one place there does so here
    body = replace(body, skeleton=replace(body.skeleton, scale=scale), skin=replace(body.skin, rest=rest))
    motion = replace(stride(capsule_body(vertices=900), 6), skeleton=body.skeleton)
    matrices = joint_matrices(body.skeleton, motion)[3]
    weights = [0.5] * len(body.skin.morphs)
    names = [x for x in NAMES if x not in ("contours", "hand")]
    answer = in_page(tmp_path, [(body, matrices, names, None, {"weights": weights})])[0]
    for name in names:
        wanted = deformer(name, body)(matrices, {m.name: 0.5 for m in body.skin.morphs})
        assert np.abs(answer[name]["points"] - wanted).max() < 1e-4, name


def test_turns_beyond_half_a_turn_have_the_signs_of_the_kernels(tmp_path) -> None:
    body = capsule_body(vertices=900)
    random, parents, count = np.random.default_rng(7), body.skeleton.parents, len(body.skin.rest)
    rows = []
    for v in range(count):  # several joints of one chain, and a part that stays
        joint = int(random.integers(len(parents)))
        own = [joint]
        while parents[own[-1]] >= 0 and len(own) < 4:
            own.append(int(parents[own[-1]]))
        share = random.dirichlet(np.ones(len(own))) * (1 if v % 7 else 0.8)
        rows += [(v, j, w) for j, w in zip(own, share)]
    vertex, joint, weight = (np.array(column) for column in zip(*rows))
    rest = body.skin.rest.astype(np.float32).astype(float)
    body = replace(body, skin=replace(body.skin, rest=rest, weights=Weights.from_pairs(count, vertex, joint, weight)))
    names = [x for x in NAMES if x not in ("contours", "hand")]
    cases = []
    for reach in (0.3, 1.5, 2.6, 2.6, 2.6):
        axes = random.normal(size=(len(parents), 3))
        turns = np.column_stack([axes, random.uniform(-reach, reach, len(parents))])
        cases.append((body, posed(body, dict(zip(body.skeleton.names, turns))), names, None, {}))
    for (body, matrices, *_), answer in zip(cases, in_page(tmp_path, cases)):
        for name in names:
            wanted = deformer(name, body)(matrices)
            assert np.abs(answer[name]["points"] - wanted).max() < 1e-5, name


@pytest.mark.parametrize(("axis", "degrees"), [((0, 0, 1), 90), ((0, 0, 1), 135), ((1, 0, 0), 90), ((1, 0, 0), 135)])
def test_the_page_knows_the_closed_forms_of_the_cylinder(axis, degrees, tmp_path) -> None:
    body = skins.cylinder(skins.halves)
    body = replace(body, skeleton=replace(body.skeleton, parents=np.array([-1, 0])))
    matrices = skins.turned(axis, degrees)
    answer = in_page(tmp_path, [(body, matrices, ["linear", "log"], ["j1"], {"measured": MEASURED})])[0]
    half = np.cos(np.radians(degrees) / 2)
    linear, log = (answer[k]["quality"]["whole"] for k in ("linear", "log"))
    assert linear["thickness"] == pytest.approx(half, abs=1e-4)
    assert linear["area"] == pytest.approx(half**2 if axis == (0, 0, 1) else half, abs=1e-4)
    assert log["area"] == pytest.approx(1, abs=1e-3) and log["volume"] >= 0.999 and log["gap"] == 0


def test_displacers_before_skinning_reach_contours_too(people, tmp_path) -> None:
    body, matrices = people[1]
    moved = np.unique(body.contours[0].vertices[:4])
    morph = Morph("swell", moved, np.tile([0.0, 0.0, 0.02], (len(moved), 1)), int(body.contours[0].joint), before=True)
    body = replace(body, skin=replace(body.skin, morphs=(morph,)))
    answer = in_page(tmp_path, [(body, matrices, ["contours"], None, {"weights": [1.0]})])[0]
    wanted = deformer("contours", body)(matrices, {"swell": 1.0})
    assert np.abs(answer["contours"]["points"] - wanted).max() < 1e-5
    assert np.abs(wanted - deformer("contours", body)(matrices)).max() > 0.015
