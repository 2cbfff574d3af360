"""Contours at bends: centres that keep to the bone, and contours that are fanned for the bend in advance."""

import json
import subprocess
import sys
from copy import deepcopy
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vitruvian as vt
from test_contours import TURNS, exact, posed, tube
from vitruvian.body.contours import limb
from vitruvian.body.types import Body
from vitruvian.deform import contour_steps
from vitruvian.deform import contours as operator
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianError
from vitruvian.modeling.contours import contours
from vitruvian.modeling.fans import Fan, fan
from vitruvian.modeling.tuning import tuned

DOWN = np.array([0.0, -1.0, 0.0])
ELBOW, KNEE = ("elbow", "upperarm", "forearm", -1), ("knee", "thigh", "calf", 1)
OPTIONS = {"plain": {}, "tilt": {"tilt": 1.0}, "recentre": {"recentre": True}, "both": {"tilt": 1.0, "recentre": True}}


def wound(**options):
    """A tube off its bones, whose surfaces take twists apart from bends, as those of bodies do."""
    return tube(joints=3, offset=(0.15, -0.1), spread=(True, False), axes=np.tile(DOWN, (2, 1)), **options)[0]


def centres(body, points, matrices):
    """For each surface (C,) how much further its contours' centres are from its bone than at rest, m."""
    out = []
    for s in body.contours:
        m, start = matrices[s.joint], body.skeleton.centers[s.joint]
        away = []
        for p, origin, way in (
            (body.skin.rest, start, DOWN),
            (points, m[:3, :3] @ start + m[:3, 3], m[:3, :3] @ DOWN),
        ):
            x = p[s.vertices].mean(axis=1) - origin
            away.append(np.linalg.norm(x - (x @ way)[:, None] * way, axis=1))
        out.append(away[1] - away[0])
    return out


@pytest.mark.parametrize("turn", [*TURNS, [0, 1, 0, 2.0], [1, 0, 0, 2.3]])
@pytest.mark.parametrize("options", [{}, {"diversion": 0.5}, {"mitre": 0.7}])
def test_centres_keep_their_distances_from_the_bone(turn, options):
    """From that of either surface at a seam; without, they swing aside by centimetres."""
    body, plain = wound(recentre=True, **options), wound(**options)
    m = posed(body.skeleton, j1=turn, j2=[0.3, 0, 1, 0.7], j0=[0.3, 0.2, 1, 0.4])
    kept, lost = (np.abs(np.concatenate(centres(b, exact(b, m), m))) for b in (body, plain))
    print(f"off the bone by {kept.max():.1e} m with recentre, {lost.max():.3f} m without")
    assert kept.max() < 1e-12 < 0.01 < lost.max()


def test_contours_turn_about_their_places_on_the_bone():
    """In a plain bend centres on the bone stay where they are on it, and the centre of the seam at the joint."""
    body, _ = tube(recentre=True)
    m = posed(body.skeleton, j1=[1, 0, 0, 1.8])
    out = exact(body, m)
    for s in body.contours:
        rest = body.skin.rest[s.vertices].mean(axis=1)
        assert np.abs(out[s.vertices].mean(axis=1) - rest @ m[s.joint, :3, :3].T - m[s.joint, :3, 3]).max() < 1e-12


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("native", [True, False])
@pytest.mark.parametrize("options", [{}, {"diversion": 0.5, "mitre": 0.7}])
def test_recentred_seams_do_not_open_by_a_bit(turn, native, options, monkeypatch):
    if not native:
        monkeypatch.setattr(operator, "kernels", lambda: None)
    for body in (wound(recentre=True, **options), tube(joints=3, offset=(0.1, 0.1), recentre=True, **options)[0]):
        m = posed(body.skeleton, j1=turn, j2=[0, 1, 0.2, 0.7], j0=[0.3, 0.2, 1, 0.4])
        out = deformer("contours", body)(m)
        for upper, lower in zip(body.contours, body.contours[1:], strict=False):
            assert np.array_equal(out[upper.vertices[-1]], out[lower.vertices[0]])
        rest = deformer("contours", body)(np.tile(np.eye(4), (3, 1, 1)))
        assert np.array_equal(rest, body.skin.rest.astype(np.float32))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.floats(-3.1, 3.1), st.floats(-3.1, 3.1))
def test_the_kernel_recentres_as_its_twin_and_turns_with_the_character(seed, a, b):
    rng = np.random.default_rng(seed)
    body, _ = tube(joints=3, offset=(0.15, -0.1), recentre=True, diversion=0.3, mitre=0.6)
    some = replace(body.contours[1], recentre=rng.random(15), axes=rng.normal(size=(2, 3)))
    body = replace(body, contours=(body.contours[0], some, body.contours[2]))
    axes = rng.normal(size=(2, 3))
    m = np.stack([
        posed(body.skeleton, j0=[0, 1, 1, b], j1=[*axes[0], a + step], j2=[*axes[1], b]) for step in (0, 0.2, 0.4)
    ])  # fmt: skip
    program = deformer("contours", body).operator.program
    native, twin = contour_steps.motions(program, m)[:, 3:], contour_steps.twin(program, m)
    assert np.isfinite(native).all() and np.abs(native - twin).max() < 1e-9
    g = posed(body.skeleton, j0=[*rng.normal(size=3), 1.0])[0]
    assert np.abs(contour_steps.motions(program, g @ m)[:, 3:] - g @ native).max() < 1e-9


def test_what_is_not_recentred_reads_nothing_of_it():
    """To the bit, whatever stands in the arrays; a ramp that begins on another part is left alone too."""
    body, _ = tube(joints=3, offset=(0.15, -0.1), diversion=0.4, mitre=0.3)
    program = deformer("contours", body).operator.program
    other = replace(program, way=program.way + 7, aside=program.aside * 3, seam=program.seam + 1, limb=program.limb * 0)
    m = posed(body.skeleton, j1=[1, 0, 0, 1.4], j2=[0, 1, 0.2, 0.7])[None]
    assert np.array_equal(contour_steps.motions(program, m), contour_steps.motions(other, m))
    assert np.array_equal(contour_steps.twin(program, m), contour_steps.twin(other, m))
    numbers = np.arange(60).reshape(15, 4)
    fixed = limb("s", numbers, 1, None, fixed=3, upper=6, recentre=True)
    assert fixed.recentre.tolist() == [0] * 9 + [1] * 6
    assert limb("s", numbers, 1, 2, upper=5, lower=4, recentre=True).recentre.all()
    off = deformer("contours", tube(recentre=True, offset=(0.1, 0))[0], off=["s1"]).operator.program
    assert off.recentre[:15].any() and not off.recentre[15:].any()


@pytest.fixture(scope="module")
def bodies():
    """The bare person in contours: {option: body}."""
    person = vt.person(outfit=None)
    return {name: vt.pack(contours(person, **options)) for name, options in OPTIONS.items()}


def gaps(body: Body, joint: str, upper: str, lower: str, sign: int, degrees: float) -> dict[str, np.ndarray]:
    """How far apart neighbouring contours are along the inner and the outer side of a limb, from the middle of the upper
    part to the middle of the lower, in millimetres."""
    by = {s.name: s.vertices for s in body.contours}
    a, b = by[f"l_{upper}_def"], by[f"l_{lower}_def"]
    rows = np.concatenate([a[len(a) // 2 :], b[1 : len(b) // 2 + 1]])
    points = deformer("contours", body)(posed(body.skeleton, **{f"l_{joint}": [sign, 0, 0, np.radians(degrees)]}))
    columns = {"front": 0, "back": rows.shape[1] // 2}  # the first point of each contour is in front
    front = np.linalg.norm(np.diff(points[rows[:, columns["front"]]].astype(float), axis=0), axis=1) * 1000
    back = np.linalg.norm(np.diff(points[rows[:, columns["back"]]].astype(float), axis=0), axis=1) * 1000
    return {"inner": front, "outer": back} if sign < 0 else {"inner": back, "outer": front}


@pytest.mark.parametrize("joint", [ELBOW, KNEE])
@pytest.mark.parametrize("pair", [("plain", "tilt"), ("recentre", "both")])
def test_tilted_contours_of_a_bent_joint_are_more_evenly_apart(bodies, joint, pair):
    """Bent by 90 degrees they crowd much less on the inner side, and the two sides differ less."""
    told = {}
    for name in pair:
        found = gaps(bodies[name], *joint, 90)
        inner, outer = found["inner"], found["outer"]
        told[name] = {
            "inner": inner.std() / inner.mean(),
            "least": inner.min(),
            "apart": np.log(outer / inner).std() + abs(np.log(outer / inner).mean()),
            "ratio": (outer / inner).max(),
        }
        print(joint[0], name, {k: round(float(v), 3) for k, v in told[name].items()})
    without, with_ = (told[n] for n in pair)
    assert with_["inner"] < 0.75 * without["inner"] + 0.15 * (pair[0] == "recentre")
    assert with_["least"] > 1.4 * without["least"]
    assert with_["apart"] < 0.75 * without["apart"] and with_["ratio"] < 0.6 * without["ratio"]


def test_half_of_the_tilt_is_half_of_the_angle():
    places = np.linspace(0, 1, 21)
    s = np.array([0.0, 0.1, 0.2, 0.5, 0.8, 1.0])
    below = fan("knee", "talocrural", DOWN, np.array([0, 0, 1.0]), reach=0.2, tilt=1.0, places=places)
    assert isinstance(below, Fan) and np.allclose(below.axis, [1, 0, 0])  # the heel goes back
    lean = below.lean(s)
    assert np.allclose(lean[[0, 4, 5]], 0) and lean[2] == pytest.approx(-np.pi / 4 * 0.75) and lean[1] < 0 > lean[3]
    assert np.allclose(replace(below, tilt=0.5).lean(s), lean / 2)
    normal = below.turned(np.tile(DOWN, (6, 1)), s)
    assert np.allclose(np.linalg.norm(normal, axis=1), 1) and normal[2, 2] > 0.5  # its inner edge, behind, lies lower
    above = fan("shoulder", "elbow", DOWN, np.array([0, 0, 1.0]), reach=0.2, tilt=1.0, places=places)
    assert above is not None and np.allclose(above.axis, [-1, 0, 0]) and above.lean(np.array([0.8]))[0] > 0
    assert fan("hip", "ankle", DOWN, np.array([0, 0, 1.0]), reach=0.2, tilt=1.0, places=places) is None
    assert fan("hip", "knee", np.array([0, 0, 1.0]), np.array([0, 0, 1.0]), reach=0.2, tilt=1.0, places=places) is None


def test_bodies_stay_closed_with_both(bodies):
    """Knees, elbows and what is sewn to the contours, to the bit, in hard poses."""
    rng = np.random.default_rng(7)
    names = [f"{s}_{j}" for s in "lr" for j in ("knee", "elbow", "hip", "shoulder", "radiocarpal", "talocrural")]
    poses = [{n: [*rng.normal(size=3), rng.uniform(0, 2)] for n in [*names, "vl5", "vt6"]} for _ in range(4)]
    for name in ("tilt", "recentre", "both"):
        body = bodies[name]
        by = {s.name: s for s in body.contours}
        out = deformer("contours", body)(np.stack([posed(body.skeleton, **p) for p in poses]))
        for a, b in (("thigh", "calf"), ("upperarm", "forearm")):
            for side in "lr":
                above, below = by[f"{side}_{a}_def"].vertices[-1], by[f"{side}_{b}_def"].vertices[0]
                assert np.array_equal(body.skin.rest[above], body.skin.rest[below])
                assert np.array_equal(out[:, above], out[:, below])
        for s in body.contours:
            for v, k in s.tied.tolist():
                ring = s.vertices[k]
                twin = ring[np.argmin(np.abs(body.skin.rest[ring] - body.skin.rest[v]).max(axis=1))]
                assert np.array_equal(out[:, v], out[:, twin])


def test_only_knees_and_elbows_move_and_only_what_is_asked_for(bodies):
    plain, tilted, kept = (
        {s.name: b.skin.rest[s.vertices] for s in b.contours}
        for b in (bodies["plain"], bodies["tilt"], bodies["recentre"])
    )
    for name, points in plain.items():
        limb_ = name.split("_")[1] in ("thigh", "calf", "upperarm", "forearm")
        assert np.array_equal(points[[0, -1]], tilted[name][[0, -1]])  # ends are sewn
        assert np.array_equal(points, tilted[name]) != limb_
        assert np.array_equal(points, kept[name])
    some = {s.name: s for s in bodies["recentre"].contours}
    assert some["l_calf_def"].recentre[0] == some["l_thigh_def"].recentre[-1] == 1
    assert not any(s.recentre.any() for s in bodies["plain"].contours)
    assert not some["l5_front_def"].recentre.any() and some["l_thigh_def"].recentre.all()


@pytest.fixture(scope="module")
def small():
    person = vt.person(outfit=None, loa=1)
    return contours(person, density=0.5, recentre=True, tilt={"l_thigh_def": 0.7, "r_forearm_def": 0.25})


@pytest.mark.parametrize("kind", [".x3d", ".wrl", ".x3dj"])
def test_tilt_and_recentre_are_kept_in_files(small, kind, tmp_path):
    made = deepcopy(small)
    tuned(made, {"r_calf_def": {"recentre": 0, "ramp": "smoothstep"}, "l_upperarm_def": {"bulge": 0.3}})
    vt.save(made, tmp_path / f"p{kind}")
    again = vt.load(tmp_path / f"p{kind}")
    found = {c.name: c for s in again.segments() for c in s.contours}
    assert {n: c.tilt for n, c in found.items() if c.tilt} == {"l_thigh_def": 0.7, "r_forearm_def": 0.25}
    assert not found["r_calf_def"].recentre and found["l_calf_def"].recentre and not found["l5_front_def"].recentre
    assert [n for n, c in found.items() if c.ramp != "linear"] == ["r_calf_def"]
    assert {n: c.bulge for n, c in found.items() if c.bulge} == {"l_upperarm_def": 0.3}
    first, second = (vt.pack(h) for h in (made, again))
    m = posed(first.skeleton, l_knee=[1, 0, 0, 1.5], r_knee=[1, 0, 0, 1.2], r_elbow=[-1, 0, 0, 1.4])
    for a, b in zip(first.contours, second.contours, strict=True):
        assert np.array_equal(a.recentre, b.recentre) and np.allclose(a.swing, b.swing, atol=1e-6)
        ours, theirs = (deformer("contours", x)(m)[s.vertices] for x, s in ((first, a), (second, b)))
        assert np.abs(ours - theirs).max() < 1e-6
    if kind == ".x3d":  # sliced again, contours fan as they did
        for tilt, wanted in ((None, [0.7, 0.25]), (0.1, [0.1] * 8)):
            sliced = [
                c for s in contours(again, density=0.5, tilt=tilt, ramp="smoothstep").segments() for c in s.contours
            ]
            assert [c.tilt for c in sliced if c.tilt] == wanted
            assert {c.ramp for c in sliced if c.tilt} == {"smoothstep"}


def test_parts_with_other_parameters_still_meet(small):
    """A part's first contour does as the last of the part above it."""
    made = deepcopy(small)
    tuned(made, {"l_thigh_def": {"recentre": 0, "mitre": 0.8}, "r_forearm_def": {"recentre": 0, "mitre": 0}})
    tuned(made, {"l_calf_def": {"ramp": "smoothstep"}, "r_upperarm_def": {"ramp": "smoothstep"}})
    body = vt.pack(made)
    by = {s.name: s.vertices for s in body.contours}
    out = deformer("contours", body)(posed(body.skeleton, l_knee=[1, 0.2, 0, 1.6], r_elbow=[-1, 0, 0.3, 1.4]))
    assert np.array_equal(out[by["l_thigh_def"][-1]], out[by["l_calf_def"][0]])
    assert np.array_equal(out[by["r_upperarm_def"][-1]], out[by["r_forearm_def"][0]])


def test_what_is_asked_wrongly_is_named(small):
    with pytest.raises(VitruvianError, match="tilt: expected a surface at a knee or elbow, one of l_upperarm_def"):
        contours(vt.person(outfit=None, loa=1), tilt={"c7_def": 0.5})
    with pytest.raises(VitruvianError, match="l_calf_def tilt: expected 0 to 1"):
        contours(vt.person(outfit=None, loa=1), tilt={"l_calf_def": 1.5})
    with pytest.raises(VitruvianError, match="l_thigh_def recentre: expected 0 or 1"):
        tuned(small, {"l_thigh_def": {"recentre": 0.5}})
    with pytest.raises(VitruvianError, match="l_thigh_def parameter: expected one of bulge, diversion"):
        tuned(small, {"l_thigh_def": {"tilt": 0.5}})
    with pytest.raises(VitruvianError, match="l_thigh_def ramp: expected linear or smoothstep, found 'steep'"):
        tuned(small, {"l_thigh_def": {"ramp": "steep"}})
    with pytest.raises(VitruvianError, match="l_thigh_def mitre: expected a number"):
        tuned(small, {"l_thigh_def": {"mitre": "much"}})


def test_ramps_are_smooth_on_request(small, tmp_path):
    """The steps of a smooth ramp begin and end small; a ramp that a file gives another name is refused."""
    made = deepcopy(small)
    swing = {}
    for ramp in ("linear", "smoothstep"):
        tuned(made, {"l_forearm_def": {"ramp": ramp, "upper": 6}})
        swing[ramp] = next(s for s in vt.pack(made).contours if s.name == "l_forearm_def").swing[:7, 0]
    along = 2 * swing["linear"] - 1
    assert along[0] == 0 and along[6] == 1 and np.ptp(np.diff(along)) < 0.1
    assert np.allclose(swing["smoothstep"], 0.5 + 0.5 * along**2 * (3 - 2 * along), atol=1e-12)
    vt.save(made, tmp_path / "p.x3d")
    text = (tmp_path / "p.x3d").read_text()
    assert text.count("value='smoothstep'") == 1
    (tmp_path / "p.x3d").write_text(text.replace("value='smoothstep'", "value='steep'"))
    with pytest.raises(VitruvianError, match="ramp: expected linear or smoothstep, found 'steep'"):
        vt.load(tmp_path / "p.x3d")


def test_the_command_takes_both_for_all_parts_and_for_each(tmp_path):
    out = tmp_path / "p.x3d"
    command = [sys.executable, "-m", "vitruvian", "contours", "person", "-o", str(out), "--density", "0.5", "--json"]
    more = [
        "--tilt",
        "0.25",
        "--recentre",
        "--set",
        "l_thigh_def.tilt=1",
        "--set",
        "r_calf_def.recentre=0",
        "--ramp",
        "smoothstep",
        "--set",
        "l_calf_def.ramp=linear",
    ]
    done = subprocess.run([*command, *more], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0 and json.loads(done.stdout)["surfaces"] == 11, done.stderr
    found = {c.name: c for s in vt.load(out).segments() for c in s.contours}
    assert found["l_thigh_def"].tilt == 1 and found["r_thigh_def"].tilt == 0.25
    assert found["r_thigh_def"].recentre and not found["r_calf_def"].recentre
    assert found["l_calf_def"].ramp == "linear" and found["r_calf_def"].ramp == "smoothstep"


def test_a_muscle_swells_with_the_next_joint_and_not_at_seams(small):
    made = deepcopy(small)
    bend = {}
    for gain in (0.0, 0.3):
        tuned(made, {"l_upperarm_def": {"bulge": gain}})
        body = vt.pack(made)
        by = {s.name: s.vertices for s in body.contours}
        for angle in (0.0, 1.2, 2.4):
            out = deformer("contours", body)(posed(body.skeleton, l_elbow=[-1, 0, 0, angle])).astype(float)
            assert np.array_equal(out[by["l_upperarm_def"][-1]], out[by["l_forearm_def"][0]])
            middle = out[by["l_upperarm_def"][len(by["l_upperarm_def"]) // 2]]
            bend[gain, angle] = np.linalg.norm(middle - middle.mean(axis=0), axis=1).mean()
    assert bend[0.0, 0.0] == bend[0.3, 0.0]
    wider = [bend[0.3, a] / bend[0.0, a] for a in (1.2, 2.4)]
    belly = next(s for s in body.contours if s.name == "l_upperarm_def").bulge[len(by["l_upperarm_def"]) // 2]
    assert wider == pytest.approx([1 + belly * (1 - np.cos(a)) / 2 for a in (1.2, 2.4)], abs=5e-3) and wider[1] > 1.2


def test_levels_of_detail_are_recentred_alike(bodies):
    from vitruvian.modeling.detail import coarser

    body = bodies["both"]
    strong = [replace(s, bulge=0.3 * np.sin(np.linspace(0, np.pi, len(s))), muscle=0) for s in body.contours]
    body = replace(body, contours=tuple(strong))
    small, source = coarser(body, contours=3, points=2)
    m = posed(body.skeleton, l_knee=[1, 0, 0, 1.4], r_elbow=[-1, 0, 0, 1.2], l_radiocarpal=[0, 1, 1, 0.8])
    assert np.array_equal(deformer("contours", small)(m), deformer("contours", body)(m)[source])
    assert {f.name for f in fields(contour_steps.Program)} >= {"recentre", "limb", "way", "aside", "seam"}
