"""What a body has, on other surfaces: weights with truth known, texture coordinates, Sites, Displacers, contours."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import vitruvian as vt
from vitruvian import VitruvianError, VitruvianWarning
from vitruvian.body.rotations import from_axis_angle
from vitruvian.cli import app
from vitruvian.hanim.humanoid import Humanoid, Shape
from vitruvian.modeling import aligning, shrink
from vitruvian.modeling.person import humanoid_of
from vitruvian.modeling.reuse import reuse
from vitruvian.modeling.shape import Shape as Sliders
from vitruvian.modeling.transfer import match
from vitruvian.modeling.weights import table

SKIN = 13380  # points of the built-in person's skin


@pytest.fixture(scope="module")
def woman():
    return humanoid_of(Sliders(gender=0.0), outfit=None, hair="none")


@pytest.fixture(scope="module")
def man():
    return humanoid_of(Sliders(gender=1.0), outfit=None, hair="none")


def bare(humanoid):
    """A copy of joints and skin alone."""
    out = humanoid.copied()
    for joint in out.joints():
        joint.skin_coord_index, joint.skin_coord_weight = np.zeros(0, np.int32), np.zeros(0)
        joint.displacers, joint.sites = [], []
        for segment in joint.segments:
            segment.sites = []
    out.skin = [replace(s, uv=None, uv_triangles=None) for s in out.skin]
    return out


def off(found, truth):
    return 0.5 * np.asarray(abs(found - truth).sum(axis=1)).ravel()


@pytest.fixture(scope="module")
def given(woman, man):
    return reuse(woman, bare(man))


def test_weights_of_a_woman_are_those_of_a_man(given, man):
    mine, truth = vt.pack(given.humanoid), vt.pack(man)
    joints = len(truth.skeleton)
    error = off(table(mine.skin.weights, joints)[:SKIN], table(truth.skin.weights, joints)[:SKIN])
    assert error.mean() <= 0.03 and np.quantile(error, 0.95) <= 0.12
    assert np.abs(mine.skin.weights.sums - 1).max() < 1e-6
    assert given.kind == "body" and given.report["filled"] < 0.15


def test_sites_and_displacers_come_to_their_places(given, man):
    mine, truth = vt.pack(given.humanoid), vt.pack(man)
    index = mine.skeleton.site_index
    assert set(index) == set(truth.skeleton.site_names)
    places = mine.skeleton.site_points[[index[n] for n in truth.skeleton.site_names]]
    away = np.linalg.norm(places - truth.skeleton.site_points, axis=1)
    assert away.mean() < 0.002 and away.max() < 0.02
    assert given.report["displacers"] == len(man.displacers())
    found = {m.name: m for m in mine.skin.morphs}

    def field(morph):
        out = np.zeros((len(truth.skin.rest), 3))
        out[morph.index] = morph.offset
        return out[:SKIN]

    for morph in truth.skin.morphs:
        want = field(morph)
        if np.abs(want).max() > 0.002:
            assert np.linalg.norm(field(found[morph.name]) - want) < 0.6 * np.linalg.norm(want), morph.name
    there = {d.name: set(d.coord_index.tolist()) for d in given.humanoid.displacers() if d.marks}
    for region in (d for d in man.displacers() if d.marks):
        here = {v for v in region.coord_index.tolist() if v < SKIN}
        kept = {v for v in there[region.name] if v < SKIN}
        assert len(here & kept) > 0.6 * len(here | kept), region.name


def test_texture_coordinates_do_not_cross_seams(given, man):
    mine, truth = vt.pack(given.humanoid).skin, vt.pack(man).skin
    count = next(p.stop for p in truth.parts if p.name == "skin")
    ours, theirs = (s.uv[s.uv_triangles[:count]] for s in (mine, truth))
    error = np.linalg.norm(ours - theirs, axis=2).max(axis=1)
    assert np.median(error) < 1e-3 and (error < 0.02).mean() > 0.98
    corners = man.skin_coord[man.skin[0].triangles[:, [0, 1, 2, 0]]]
    stretch = np.linalg.norm(np.diff(ours[:, [0, 1, 2, 0]], axis=1), axis=2) / np.linalg.norm(
        np.diff(corners, axis=1), axis=2
    )
    assert (stretch.max(axis=1) < 4).mean() > 0.98  # the whole map is 1 wide, the body 1.7 m high


def test_another_topology_of_random_people():
    """Seeds that nothing was tuned on; the target has other triangles and fewer points."""
    import igl

    rng = np.random.default_rng(977)
    source, target = (
        humanoid_of(
            Sliders(gender=float(rng.uniform()), age=float(rng.uniform(18, 70)), weight=float(rng.uniform(0.3, 0.7)),
                    height=float(rng.uniform(0.2, 0.8)), muscle=float(rng.uniform(0.3, 0.7))),
            outfit=None, hair="none",
        )
        for _ in range(2)
    )  # fmt: skip
    body, other = vt.pack(source), vt.pack(target)
    skin = target.skin[0].triangles
    points, faces = igl.qslim(target.skin_coord[:SKIN], skin.astype(np.int64), 12_000)[:2]
    face, share = shrink.closest(points, shrink.surface(target.skin_coord[:SKIN], skin))[2:]
    truth = shrink.blend(skin[face], share, len(other.skin.rest)) @ table(other.skin.weights, len(body.skeleton))
    mesh = vt.Mesh(points, np.asarray(faces, np.int32))
    made = vt.transfer(body, mesh, skeleton=other.skeleton)
    error = off(table(made.weights, len(body.skeleton)), truth)
    near = source.skin_coord[:SKIN]
    face, share = shrink.closest(points, shrink.surface(near, source.skin[0].triangles))[2:]
    corners = source.skin[0].triangles[face]
    plain = off(shrink.blend(corners, share, len(body.skin.rest)) @ table(body.skin.weights, len(body.skeleton)), truth)
    assert error.mean() <= 0.04 and np.quantile(error, 0.95) <= 0.2
    assert plain.mean() > 4 * error.mean()


def test_a_body_that_is_no_built_in_person_goes_by_its_joints(woman, man, monkeypatch):
    monkeypatch.setattr(aligning, "_modes", lambda *_: None)
    body, other = vt.pack(woman), vt.pack(man)
    made = match(body, vt.Mesh(man.skin_coord[:SKIN], man.skin[0].triangles), skeleton=other.skeleton)
    truth = table(other.skin.weights, len(body.skeleton))[:SKIN]
    error = off(table(made.skin.weights, len(body.skeleton)), truth)
    assert error.mean() < 0.09  # joints and closest points alone: 0.12


def test_fewer_joints_take_what_hangs_below_them(woman, man):
    coarse = humanoid_of(Sliders(gender=1.0), outfit=None, hair="none", loa=1)
    made = reuse(woman, bare(coarse))
    body, truth = vt.pack(made.humanoid), vt.pack(coarse)
    assert body.skeleton.names == truth.skeleton.names
    error = off(*(table(b.skin.weights, len(b.skeleton))[:SKIN] for b in (body, truth)))
    assert error.mean() < 0.04 and np.quantile(error, 0.95) < 0.2


def tube(center, axis, radius, length, rings=20, points=48, hole=False):
    """A tube about a line; with `hole` some of its faces are missing."""
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    u = np.cross(axis, [0.3, 0.1, 0.9])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    angle = np.tile(np.arange(points) * 2 * np.pi / points, rings)
    along = np.repeat(np.linspace(-length / 2, length / 2, rings), points)
    vertices = np.asarray(center) + along[:, None] * axis
    vertices = vertices + radius * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)
    a = np.arange(points)
    b = (a + 1) % points
    quads = np.concatenate(
        [np.stack([r + a, r + b, r + points + b, r + points + a], 1) for r in np.arange(rings - 1) * points]
    )
    faces = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    return vertices, np.delete(faces, np.s_[100:140], axis=0) if hole else faces


def upper_arm(body, hole=True):
    a, b = (body.skeleton.centers[body.skeleton.index[n]] for n in ("l_shoulder", "l_elbow"))
    inner, f = tube((a + 2 * b) / 3, b - a, 0.055, 0.2, hole=hole)
    outer, g = tube((a + 2 * b) / 3, b - a, 0.065, 0.2)
    return vt.Mesh(np.concatenate([inner, outer]), np.concatenate([f, g + len(inner)]).astype(np.int32), name="sleeve")


def test_a_garment_with_holes_and_layers_follows_the_arm(woman, tmp_path):
    body = vt.pack(woman)
    mesh = upper_arm(body)
    made = reuse(woman, mesh, wear=True)
    assert made.kind == "garment" and len(made.humanoid.skin) == len(woman.skin) + 1
    assert len(made.humanoid.skin_coord) == len(woman.skin_coord) + len(mesh.vertices)
    worn = vt.pack(made.humanoid)
    matrices = vt.joint_matrices(worn.skeleton)
    turned = np.tile([0.0, 0, 0, 1], (1, len(worn.skeleton), 1))
    turned[0, worn.skeleton.index["l_elbow"]] = from_axis_angle([1, 0, 0, -1.6])
    turned[0, worn.skeleton.index["l_shoulder"]] = from_axis_angle([0, 0, 1, 1.0])
    matrices = vt.joint_matrices(worn.skeleton, vt.Motion(worn.skeleton, 30.0, turned, np.zeros((1, 3))))
    before, after = worn.skin.rest, vt.deformer("log", worn)(matrices)[0].astype(float)
    first = len(woman.skin_coord)
    gap = [shrink.closest(p[first:], shrink.surface(p[:SKIN], woman.skin[0].triangles))[0] for p in (before, after)]
    assert np.abs(gap[1] - gap[0]).mean() < 0.006
    inner, outer = np.split(after[first:], 2)
    assert np.linalg.norm(inner - outer, axis=1).min() > 0.004  # layers do not meet
    vt.save(made.humanoid, tmp_path / "worn.x3d")
    assert len(vt.pack(vt.load(tmp_path / "worn.x3d")).skin.rest) == len(worn.skin.rest)


def test_an_accessory_goes_with_one_segment(woman):
    body = vt.pack(woman)
    wrist = body.skeleton.centers[body.skeleton.index["l_radiocarpal"]]
    ring, faces = tube(wrist, [0, 1, 0], 0.04, 0.02)
    made = reuse(woman, vt.Mesh(ring, faces, name="watch"), joint="", wear=True)
    assert made.kind == "accessory" and made.report["joint"] in ("l_elbow", "l_radiocarpal")
    holder = made.humanoid.joint(made.report["joint"])
    assert np.array_equal(holder.segments[0].shapes[-1].points, ring)
    alone = reuse(woman, vt.Mesh(ring, faces), joint="skullbase").humanoid
    packed = vt.pack(alone)
    assert set(packed.skin.weights.joint) == {packed.skeleton.index["skullbase"]}
    with pytest.raises(VitruvianError, match="did you mean l_elbow"):
        reuse(woman, vt.Mesh(ring, faces), joint="l_elbw")


def test_targets_that_cannot_be_meant_are_one_line(woman):
    body = vt.pack(woman)
    mesh = upper_arm(body)
    cases = {
        "found no triangles": replace(mesh, triangles=np.zeros((0, 3), np.int32)),
        "without area": replace(mesh, vertices=np.zeros_like(mesh.vertices)),
        "in mm it would lie on the body": replace(mesh, vertices=mesh.vertices * 1000),
        "on the body at rest": replace(mesh, vertices=mesh.vertices + [3, 0, 0]),
    }
    for text, target in cases.items():
        with pytest.raises(VitruvianError, match=text) as found:
            reuse(woman, target, kind="garment")
        assert "\n" not in str(found.value)
    with pytest.raises(VitruvianError, match="finite"):
        hurt = mesh.vertices.copy()
        hurt[7, 1] = np.nan
        reuse(woman, vt.Mesh(hurt, mesh.triangles))
    with pytest.raises(VitruvianError, match="kind"):
        reuse(woman, mesh, kind="hat")
    with pytest.raises(VitruvianError, match="unit"):
        reuse(woman, mesh, unit="furlong")
    with pytest.raises(VitruvianError, match="no|found none"):
        reuse(Humanoid("empty", skeleton=woman.copied().skeleton), mesh)
    strange = bare(woman)
    for k, joint in enumerate(strange.joints()):
        joint.name = f"bone{k}"
    with pytest.raises(VitruvianError, match="at least 4 joints"):
        reuse(woman, strange)
    stripped = bare(woman)
    stripped.skin = [Shape("empty")]
    with pytest.raises(VitruvianError, match="a surface on its joints"):
        reuse(woman, stripped)


def test_surfaces_that_are_odd_are_borne(woman):
    body = vt.pack(woman)
    mesh = upper_arm(body)
    plain = reuse(woman, mesh).humanoid
    scaled = reuse(woman, replace(mesh, vertices=mesh.vertices * 1000), unit="mm").humanoid
    assert np.abs(scaled.skin_coord - plain.skin_coord).max() < 1e-9
    inside_out = reuse(woman, replace(mesh, triangles=mesh.triangles[:, ::-1].copy())).humanoid
    a, b = (table(vt.pack(h).skin.weights, len(body.skeleton)) for h in (plain, inside_out))
    assert off(a, b).mean() < 0.02
    # three triangles on an edge, a triangle twice, a point twice in one, loose points, and many shells
    t = mesh.triangles
    fin = np.array([[t[0, 0], t[0, 1], len(mesh.vertices)], t[5], [t[9, 0], t[9, 0], t[9, 1]]])
    points = np.concatenate([mesh.vertices, mesh.vertices[:1] + [0, 0, 0.02], [[0, 1, 0.2]]])
    odd = reuse(woman, vt.Mesh(points, np.concatenate([t, fin]).astype(np.int32))).humanoid
    assert np.isfinite(vt.pack(odd).skin.weights.weight).all() and (vt.pack(odd).skin.weights.sums > 0.999).all()
    shells = np.concatenate([mesh.vertices[mesh.triangles[k]] for k in range(0, len(t), 3)])
    shells[:3] += [0.4, 0, 0]  # one of them far out
    soup = vt.Mesh(shells, np.arange(len(shells), dtype=np.int32).reshape(-1, 3))
    with pytest.warns(VitruvianWarning, match="3 of .* points lie on parts that are nowhere close"):
        rows = vt.pack(reuse(woman, soup).humanoid).skin.weights
    assert (rows.sums > 0.999).all()


def test_a_scan_gets_joints_first_and_comes_to_rest(shared, tmp_path):
    scan = vt.load(shared / "data" / "scans" / "human_man.obj")
    person = vt.person(outfit=None, hair="none")
    made = reuse(person, scan)
    body = vt.pack(made.humanoid)
    assert made.kind == "body" and len(body.skin.rest) == len(scan.vertices)
    assert len(made.humanoid.skin) == 1 and made.report["uv"] and made.report["displacers"] > 20
    sums = body.skin.weights.sums
    assert np.abs(sums - 1).max() < 1e-6
    (shape,) = made.humanoid.skin
    suit = shape.colors[np.abs(body.skin.rest[:, 1] - body.skeleton.centers[body.skeleton.index["vl3"], 1]) < 0.05]
    face = shape.colors[body.skin.rest[:, 1] > body.skeleton.centers[body.skeleton.index["skullbase"], 1] + 0.1]
    assert face.mean() > suit.mean() + 0.2  # brows, lips and a suit come along
    # arms that were stretched out hang down at rest
    assert np.ptp(scan.vertices[:, 0]) > 1.2 * np.ptp(body.skin.rest[:, 0])


def test_the_command_writes_a_body_and_says_what_it_did(woman, tmp_path):
    from vitruvian.formats.registry import save

    save(woman, tmp_path / "woman.x3d")
    mesh = upper_arm(vt.pack(woman))
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [
        f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.triangles
    ]
    (tmp_path / "sleeve.obj").write_text("\n".join(lines))
    out = tmp_path / "worn.x3d"
    call = ["transfer", str(tmp_path / "woman.x3d"), str(tmp_path / "sleeve.obj"), "-o", str(out), "--json"]
    found = CliRunner().invoke(app, call)
    assert found.exit_code == 0, found.output
    document = json.loads(found.stdout)
    assert document["kind"] == "garment" and document["points"] == len(mesh.vertices)
    assert document["uv"] and document["filled"] < 0.9
    body = vt.pack(vt.load(out))
    assert len(body.skeleton) == len(vt.pack(woman).skeleton) and len(body.skin.rest) == len(mesh.vertices)
