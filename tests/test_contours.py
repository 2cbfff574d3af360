"""The contours operator: the published formulas by hand, seams, fractions, the kernel against its twin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vitruvian as vt
from vitruvian.body.contours import Contours, distal_shares, limb, own_shares, spine_shares
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Body, Skeleton, Skin, Weights
from vitruvian.deform import contour_steps
from vitruvian.deform import contours as operator
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianError, VitruvianWarning
from vitruvian.motion.types import Motion


def ring(center, radius=1.0, points=16, axis=1):
    """(P,3) counter-clockwise seen from the top."""
    angle = np.arange(points) * 2 * np.pi / points
    out = np.zeros((points, 3))
    a, b = [(2, 0), (2, 0), (0, 1)][axis]
    out[:, a], out[:, b] = radius * np.cos(angle), radius * np.sin(angle)
    return out + center


def body_of(skeleton, surfaces, points, weights=None):
    """A body of contour surfaces: `surfaces` made with vertices numbered through `points`."""
    rest = np.concatenate([p.reshape(-1, 3) for p in points])
    owner = np.concatenate([np.full(p.shape[0] * p.shape[1], s.joint) for s, p in zip(surfaces, points, strict=True)])
    weights = weights or Weights.from_pairs(len(rest), np.arange(len(rest)), owner, np.ones(len(rest)))
    return Body("tube", skeleton, Skin(rest, np.zeros((0, 3), np.int32), weights), contours=tuple(surfaces))


def tube(count=15, ramp=5, joints=2, offset=(0.0, 0.0), radius=0.25, points=16, **options):
    """Segments of a vertical tube, each a unit long, top to bottom; surface i hangs on joint i."""
    centers = np.array([[0.0, -float(j), 0.0] for j in range(joints)])
    skeleton = Skeleton(tuple(f"j{j}" for j in range(joints)), np.arange(-1, joints - 1), centers)
    surfaces, all_points = [], []
    for j in range(joints):
        heights = -np.linspace(j, j + 1, count)
        p = np.stack([ring([offset[0], h, offset[1]], radius, points) for h in heights])
        numbers = np.arange(p.shape[0] * p.shape[1]).reshape(p.shape[:2]) + sum(
            q.shape[0] * q.shape[1] for q in all_points
        )
        distal = j + 1 if j + 1 < joints else None
        more = {"upper": ramp} if j else {}
        if distal is not None:
            more["lower"] = ramp
        surfaces.append(limb(f"s{j}", numbers, j, distal, **more, **options))
        all_points.append(p)
    return body_of(skeleton, surfaces, all_points), all_points


def posed(skeleton, **rotations):
    q = np.tile([0.0, 0, 0, 1], (len(skeleton), 1))
    for name, rotation in rotations.items():
        q[skeleton.index[name]] = from_axis_angle(rotation)
    return joint_matrices(skeleton, Motion(skeleton, 30.0, q[None], np.zeros((1, 3))))[0]


def exact(body, matrices, **options):
    """(V,3) float64 by the twin."""
    d = deformer("contours", body, **options)
    m = contour_steps.twin(d.operator.program, matrices[None])[0]
    owner = d.operator.owner
    return np.einsum("vab,vb->va", m[owner][:, :3, :3], body.skin.rest) + m[owner][:, :3, 3]


def test_the_lower_part_by_hand():
    """Formula (2): three contours of three points, bent by 1.2 about x over two contours, seen in the surface's frame."""
    y = np.array([0.0, -1, -2])
    points = np.stack([[[1, v, 0], [0, v, 1], [-1, v, 0]] for v in y])
    skeleton = Skeleton(("upper", "lower"), np.array([-1, 0]), np.array([[0.0, 1, 0], [0, 0, 0]]))
    surface = limb("s", np.arange(9).reshape(3, 3), 1, None, upper=2)
    m = posed(skeleton, lower=[1, 0, 0, 1.2])
    body = body_of(skeleton, [surface], [points])
    world = exact(body, m)
    local = (world - m[1, :3, 3]) @ m[1, :3, :3]  # before the scene graph turns the surface
    want = [
        [1, 0, 0], [0, 0.564642, 0.825336], [-1, 0, 0],
        [1, -0.955336, 0.295520], [0, -0.659816, 1.250857], [-1, -0.955336, 0.295520],
        [1, -2, 0], [0, -2, 1], [-1, -2, 0],
    ]  # fmt: skip
    assert np.abs(local - want).max() < 1e-6


def test_the_upper_part_by_hand():
    """Formula (3): the parent's last two contours take up to half of the turn; its last one is the seam."""
    points = np.array([[[0, 2, 1]], [[0, 1.5, 1]], [[0, 1, 1]]], dtype=float)
    skeleton = Skeleton(("upper", "lower"), np.array([-1, 0]), np.array([[0.0, 2, 0], [0, 1, 0]]))
    with np.errstate(all="ignore"):
        body = body_of(skeleton, [limb("q", np.arange(3).reshape(3, 1), 0, 1, lower=2)], [points])
    m = posed(skeleton, lower=[1, 0, 0, 1.2])
    local = exact(body, m) - [0, 2, 0]
    assert np.abs(local - [[0, 0, 1], [0, -0.817852, 1.103097], [0, -1.564642, 0.825336]]).max() < 1e-6
    assert np.abs(exact(body, m)[2] - [0, 0.435358, 0.825336]).max() < 1e-6


TURNS = [[1, 0, 0, 1.4], [0, 0, 1, 2.0], [0.4, -0.7, 0.3, 2.4]]


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("native", [True, False])
@pytest.mark.parametrize("options", [{}, {"diversion": 1.0}, {"mitre": 1.0}, {"diversion": 0.5, "mitre": 0.7}])
def test_a_seam_never_opens_not_even_by_a_bit(turn, native, options, monkeypatch):
    if not native:
        monkeypatch.setattr(operator, "kernels", lambda: None)
    body, points = tube(offset=(0.15, -0.1), joints=3, **options)
    m = posed(body.skeleton, j1=turn, j2=[0, 1, 0.2, 0.7], j0=[0.3, 0.2, 1, 0.4])
    out = deformer("contours", body)(m)
    for upper, lower in zip(body.contours, body.contours[1:], strict=False):
        assert np.array_equal(body.skin.rest[upper.vertices[-1]], body.skin.rest[lower.vertices[0]])
        assert np.array_equal(out[upper.vertices[-1]], out[lower.vertices[0]])


@pytest.mark.parametrize("turn", TURNS)
def test_without_its_taper_the_published_correction_tears_the_seam(turn):
    """Each copy of the seam subtracts what its own surface sees: the gap is how far the two surfaces part there."""
    body, _ = tube(offset=(0.15, -0.1), radius=1.0)
    m = posed(body.skeleton, j1=turn)
    center = np.array([0.15, -1.0, -0.1, 1.0])
    for strength in (0.5, 1.0):
        torn = tuple(
            Contours(s.name, s.joint, s.vertices, s.joints, s.swing, diversion=np.full(len(s), strength))
            for s in body.contours
        )
        out = exact(Body("torn", body.skeleton, body.skin, contours=torn), m)
        gap = np.linalg.norm(out[torn[0].vertices[-1]] - out[torn[1].vertices[0]], axis=1)
        assert np.allclose(gap, strength * np.linalg.norm((m[0] - m[1]) @ center)) and gap.min() > 0.05


def test_contours_are_skinning_by_the_logarithm_with_weights_constant_on_each():
    body, _ = tube()
    w = np.concatenate([np.repeat(s.swing[:, list(s.joints).index(1)], 16) for s in body.contours])
    n = len(w)
    weights = Weights.from_pairs(n, np.tile(np.arange(n), 2), np.repeat([0, 1], n), np.concatenate([1 - w, w]))
    skinned = Body("skin", body.skeleton, Skin(body.skin.rest, body.skin.triangles, weights))
    from vitruvian.deform import twins
    from vitruvian.deform.bind import bind
    from vitruvian.deform.motions import joint_duals
    from vitruvian.deform.se3 import to_frame

    for turn in TURNS:
        m = posed(body.skeleton, j1=turn, j0=[0.2, 0.9, 0.1, 0.8])
        rows = bind(skinned.skin.weights, 2, rigid=True)
        frames = to_frame(twins.log_pair(rows, joint_duals(m[None])[0]))
        want = np.einsum("vab,vb->va", frames[..., :3], body.skin.rest) + frames[..., 3]
        assert np.abs(exact(body, m) - want).max() < 1e-9
    shoulder = own_shares(18, fixed=3, upper=6)
    assert np.allclose(shoulder[:10], [0, 0, 0, 0, 1 / 6, 2 / 6, 3 / 6, 4 / 6, 5 / 6, 1])
    assert np.allclose(distal_shares(18, 3)[-3:], [1 / 6, 1 / 3, 1 / 2]) and not distal_shares(18, 3)[:-3].any()


def test_rest_stays_and_fixed_contours_stay_with_the_parent():
    body, _ = tube(diversion=0.5, mitre=1.0)
    rest = deformer("contours", body)(np.tile(np.eye(4), (2, 1, 1)))
    assert np.array_equal(rest, body.skin.rest.astype(np.float32))
    skeleton = body.skeleton
    fixed = limb("s", np.arange(60).reshape(15, 4), 1, None, fixed=3, upper=6)
    points = np.stack([ring([0, -h, 0], 0.2, 4) for h in np.linspace(0.8, 1.8, 15)])
    alone = body_of(skeleton, [fixed], [points])
    out = exact(alone, posed(skeleton, j1=[1, 0, 0, 1.9]))
    assert np.array_equal(out[:12], alone.skin.rest[:12])
    assert not np.allclose(out[16:20], alone.skin.rest[16:20])


def test_opposite_turns_mirror():
    body, _ = tube()
    left = exact(body, posed(body.skeleton, j1=[0, 0, 1, 1.3]))
    right = exact(body, posed(body.skeleton, j1=[0, 0, 1, -1.3]))
    mirrored = (left * [-1, 1, 1])[np.newaxis]
    distance = np.linalg.norm(right[:, None] - mirrored, axis=2).min(axis=1)
    assert distance.max() < 1e-12


def test_a_turn_past_half_a_circle_goes_on():
    body, _ = tube()
    angles = np.radians(np.arange(0, 271, 10))
    m = np.stack([posed(body.skeleton, j1=[0, 1, 0, a]) for a in angles])
    out = deformer("contours", body)(m)
    seam = body.contours[1].vertices[0]
    turned = np.unwrap(np.arctan2(out[:, seam[0], 0], out[:, seam[0], 2]))
    assert np.allclose(turned - turned[0], angles / 2, atol=1e-5)


def test_mitre_keeps_the_thickness_of_a_bend():
    for strength, low, high in ((0.0, 0.70, 0.72), (1.0, 0.99, 1.01)):
        body, _ = tube(ramp=3, mitre=strength)
        m = posed(body.skeleton, j1=[1, 0, 0, np.pi / 2])
        out = exact(body, m)
        seam = out[body.contours[1].vertices[0]]
        width = np.linalg.norm(seam[0] - seam[8]) / 0.5  # front to back, in the plane of the bend
        normal = np.array([0, 1, 1]) / np.sqrt(2)  # of the bisecting plane
        assert abs((seam - seam.mean(axis=0)) @ normal).max() < 1e-9
        assert low < width * np.cos(np.pi / 4) < high


def spine(extra=4, count=30):
    """A torso: four spine joints, neck first."""
    heights = np.linspace(1.5, 0.9, count)
    centers = np.array([[0, 0.9, 0], [0, 0.95, 0], [0, 1.1, 0], [0, 1.25, 0], [0, 1.4, 0]])
    skeleton = Skeleton(("root", "vl5", "vt10", "vt6", "vt1"), np.array([-1, 0, 1, 2, 3]), centers)
    swing, twist = spine_shares(heights, centers[1:, 1], extra=extra)
    points = np.stack([ring([0, h, 0], 0.15) for h in heights])
    half = {"joint": 1, "joints": np.arange(1, 5), "swing": swing, "twist": twist}
    front = Contours("front", vertices=np.arange(count * 9).reshape(count, 9), **half)
    back = Contours("back", vertices=np.arange(count * 9, count * 18).reshape(count, 9), **half)
    return body_of(skeleton, [front, back], [points[:, :9], points[:, [8, *range(9, 16), 0]]])


def test_a_torso_bends_by_zones_winds_evenly_and_carries_the_neck():
    body = spine()
    front, back = body.contours
    same = deformer("contours", body)(np.tile(np.eye(4), (5, 1, 1)))
    assert np.array_equal(same, body.skin.rest.astype(np.float32))
    m = posed(body.skeleton, vl5=[1, 0, 0, 0.4], vt10=[0, 0, 1, 0.3], vt6=[0.2, 1, 0, 0.5], vt1=[0, 1, 0, 0.6])
    out = deformer("contours", body)(m)
    assert np.array_equal(out[front.vertices[:, 0]], out[back.vertices[:, -1]])  # side edges
    assert np.array_equal(out[front.vertices[:, -1]], out[back.vertices[:, 0]])
    neck = front.vertices[:4].ravel()
    want = np.einsum("ab,vb->va", m[4, :3, :3], body.skin.rest[neck]) + m[4, :3, 3]
    assert np.abs(out[neck] - want).max() < 1e-6
    wound = exact(body, posed(body.skeleton, vt1=[0, 1, 0, np.radians(60)]))
    angle = np.degrees(np.unwrap(np.arctan2(wound[front.vertices[:, 0], 0], wound[front.vertices[:, 0], 2])))[::-1]
    steps = np.diff(angle)
    below = steps[(steps > 1e-9)]
    assert angle[-1] - angle[0] == pytest.approx(60) and np.ptp(below[:-1]) < 1e-9
    low = exact(body, posed(body.skeleton, vl5=[1, 0, 0, 0.5]))
    m = posed(body.skeleton, vl5=[1, 0, 0, 0.5])
    above = front.vertices[:15].ravel()
    assert np.abs(low[above] - (body.skin.rest[above] @ m[1, :3, :3].T + m[1, :3, 3])).max() < 1e-12


def test_surfaces_can_be_switched_to_rigid_pieces():
    body, _ = tube(joints=3)
    still = np.tile(np.eye(4), (3, 1, 1))
    assert np.array_equal(deformer("contours", body, off=["s2"])(still), deformer("contours", body)(still))
    m = posed(body.skeleton, j1=[1, 0, 0, 0.5], j2=[0, 0, 1, 1.0])
    out = deformer("contours", body, off=["s2"])(m)
    own = body.contours[2].vertices.ravel()
    assert np.abs(out[own] - (body.skin.rest[own] @ m[2, :3, :3].T + m[2, :3, 3])).max() < 1e-6
    with pytest.raises(VitruvianError, match="off: expected surfaces"):
        deformer("contours", body, off=["s9"])


def test_vertices_in_no_contour_move_by_their_weights():
    body, _ = tube()
    rest = np.concatenate([body.skin.rest, [[0.0, -1.2, 0.4], [0.1, -0.2, 0.2]]])
    n = len(body.skin.rest)
    pairs = [(i, int(body.skin.weights.joint[i]), 1.0) for i in range(n)]
    weights = Weights.from_pairs(n + 2, *zip(*pairs, (n, 0, 0.4), (n, 1, 0.6), (n + 1, 0, 1.0), strict=True))
    more = Body("more", body.skeleton, Skin(rest, body.skin.triangles, weights), contours=body.contours)
    m = posed(body.skeleton, j1=[1, 0, 0, 1.1])
    both = np.stack([m, posed(body.skeleton, j1=[1, 0, 0, 1.2])])
    mixed = operator.ROUND * deformer("log", more)(both) + (1 - operator.ROUND) * deformer("linear", more)(both)
    assert np.abs(deformer("contours", more)(both)[:, n:] - mixed[:, n:]).max() < 1e-6
    assert np.array_equal(deformer("contours", more)(m)[:n], deformer("contours", body)(m))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.floats(-3, 3), st.floats(-3, 3))
def test_the_kernel_does_what_its_twin_says_and_turns_with_the_character(seed, a, b):
    rng = np.random.default_rng(seed)
    body, _ = tube(joints=3, offset=(0.05, 0.02), diversion=0.6, mitre=0.8)
    surfaces = list(body.contours)
    s = surfaces[1]
    surfaces[1] = Contours(
        s.name, s.joint, s.vertices, s.joints, s.swing, np.where(rng.random(s.swing.shape) < 0.5, s.swing, np.nan),
        rng.normal(size=(2, 3)), s.diversion, s.mitre, rng.random(len(s)), 1,
    )  # fmt: skip
    body = Body("b", body.skeleton, body.skin, contours=tuple(surfaces))
    axes = rng.normal(size=(2, 3))
    m = np.stack([
        posed(body.skeleton, j0=[0, 1, 1, b], j1=[*axes[0], a + step], j2=[*axes[1], b]) for step in (0, 0.2, 0.4)
    ])  # fmt: skip
    program = deformer("contours", body).operator.program
    native, twin = contour_steps.motions(program, m)[:, 3:], contour_steps.twin(program, m)
    assert np.abs(native - twin).max() < 1e-9
    g = posed(body.skeleton, j0=[*rng.normal(size=3), 1.0])[0]
    assert np.abs(contour_steps.motions(program, g @ m)[:, 3:] - g @ native).max() < 1e-9


def test_wrong_parameters_are_named():
    vertices = np.arange(40).reshape(10, 4)
    with pytest.raises(VitruvianError, match="contours arm: UpperDef: expected 0 to 10"):
        limb("arm", vertices, 1, 2, upper=11)
    with pytest.raises(VitruvianError, match="contours arm: LowerDef"):
        limb("arm", vertices, 1, 2, lower=-1)
    with pytest.warns(VitruvianWarning, match="overlap"):
        limb("arm", vertices, 1, 2, upper=6, lower=6)
    body, _ = tube()
    with pytest.raises(VitruvianError, match="contours s0: expected vertices of its own"):
        Body("b", body.skeleton, body.skin, contours=(body.contours[0], body.contours[0]))
    with pytest.raises(VitruvianError, match="a body with contours"):
        deformer("contours", Body("b", body.skeleton, body.skin))
    assert vt.__version__


class Sliced:
    def __init__(self, made):
        self.error, self.humanoid, self.body = made.error, made.humanoid, vt.pack(made.humanoid)


@pytest.fixture(scope="module")
def sliced():
    from vitruvian.modeling.contours import contoured

    return Sliced(contoured(vt.person(gender=1)))


def test_the_built_in_person_becomes_a_contour_body(sliced):
    """Close to the original everywhere but where arms stand in the trunk, and every surface has its contours."""
    body = sliced.body
    mean, _ = sliced.error
    print(f"shape error: mean {mean * 1000:.2f} mm; {sum(s.vertices.size for s in body.contours)} points in contours")
    assert mean < 0.002
    assert {s.name for s in body.contours} >= {"l_thigh_def", "r_forearm_def", "l5_front_def", "l5_back_def", "c7_def"}
    for surface in body.contours:  # counter-clockwise seen from the top
        if surface.name.startswith("l5"):
            continue
        points = body.skin.rest[surface.vertices]
        area = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=(1, 2))
        axis = points[-1].mean(axis=0) - points[0].mean(axis=0)
        normals = contour_steps.normals(points)
        assert (normals @ axis < 0).mean() > 0.9 and np.isfinite(area).all()


def test_all_seams_of_the_contour_body_stay_shut_in_any_pose(sliced):
    """Knees and elbows to the bit; the waist, the neck and where contours meet cut triangles to a hundredth of a mm."""
    body = sliced.body
    by = {s.name: s for s in body.contours}
    rng = np.random.default_rng(5)
    skeleton = body.skeleton
    q = np.tile([0.0, 0, 0, 1], (6, len(skeleton), 1))
    for name in (
        "l_hip",
        "l_knee",
        "r_elbow",
        "r_shoulder",
        "l_elbow",
        "r_knee",
        "vl5",
        "vt6",
        "vt1",
        "vc4",
        "skullbase",
    ):
        turns = np.concatenate([rng.normal(size=(5, 3)), rng.uniform(0, 1.2, (5, 1))], axis=1)
        q[1:, skeleton.index[name]] = from_axis_angle(turns)
    m = joint_matrices(skeleton, Motion(skeleton, 30.0, q, np.zeros((6, 3))))
    out = deformer("contours", body)(m)
    for a, b in (("thigh", "calf"), ("upperarm", "forearm")):
        for side in "lr":
            above, below = by[f"{side}_{a}_def"].vertices[-1], by[f"{side}_{b}_def"].vertices[0]
            assert np.abs(body.skin.rest[above] - body.skin.rest[below]).max() < 1e-12
            assert np.array_equal(out[:, above], out[:, below])
    front, back = by["l5_front_def"].vertices, by["l5_back_def"].vertices
    assert np.array_equal(out[:, front[:, 0]], out[:, back[:, -1]])
    assert np.array_equal(out[:, front[:, -1]], out[:, back[:, 0]])
    still = np.abs(out[:1] - body.skin.rest).max()
    assert still < 1e-6


def test_a_body_without_the_joints_that_are_cut_is_refused_by_name():
    humanoid = vt.person(loa=0)
    with pytest.raises(VitruvianError, match="contours: the body needs the joints l_hip, l_knee"):
        vt.contours(humanoid)


def test_a_coarser_level_is_a_subset_to_the_bit(sliced):
    from vitruvian.modeling.detail import coarser

    small, source = coarser(sliced.body, contours=3, points=2)
    assert len(small.skin.rest) < len(sliced.body.skin.rest)
    assert sum(s.vertices.size for s in small.contours) < 0.4 * sum(s.vertices.size for s in sliced.body.contours)
    assert np.array_equal(small.skin.rest, sliced.body.skin.rest[source])
    skeleton = sliced.body.skeleton
    turns = {"l_knee": [1, 0, 0, 1.4], "r_elbow": [-1, 0, 0, 1.2], "vt6": [0.1, 1, 0, 0.4], "vc4": [0, 1, 0, 0.3]}
    m = posed(skeleton, **turns)
    assert np.array_equal(deformer("contours", small)(m), deformer("contours", sliced.body)(m)[source])
    by = {s.name: s for s in small.contours}
    out = deformer("contours", small)(m)
    assert np.array_equal(out[by["l_thigh_def"].vertices[-1]], out[by["l_calf_def"].vertices[0]])


def test_the_volume_survey_keeps_the_volume_of_a_bent_limb():
    def volume(points, surfaces):
        total = 0.0
        for s in surfaces:
            p = points[s.vertices].astype(float)
            centers = p.mean(axis=1, keepdims=True)
            area = np.cross(p - centers, np.roll(p, -1, axis=1) - centers).sum(axis=1) / 2
            total += np.sum((area[:-1] + area[1:]) / 2 * np.diff(centers[:, 0], axis=0))
        return total

    body, _ = tube(count=25, ramp=6, radius=0.12)
    m = posed(body.skeleton, j1=[1, 0, 0, np.radians(135)])
    rest = volume(body.skin.rest, body.contours)
    kept = deformer("contours", body, survey=True)(m)
    plain = deformer("contours", body)(m)
    assert abs(volume(kept, body.contours) / rest - 1) < 0.01
    assert abs(volume(plain, body.contours) / rest - 1) > 2 * abs(volume(kept, body.contours) / rest - 1)
    a, b = body.contours
    assert np.array_equal(kept[a.vertices[-1]], kept[b.vertices[0]])


def test_a_muscle_bulges_as_its_joint_bends():
    body, _ = tube()
    bump = np.sin(np.linspace(0, np.pi, 15)) ** 2
    s = body.contours[0]
    strong = Contours(s.name, s.joint, s.vertices, s.joints, s.swing, bulge=0.3 * bump, muscle=1)
    body = Body("arm", body.skeleton, body.skin, contours=(strong, body.contours[1]))
    widths = []
    for angle in (0.0, 1.0, 2.0, np.pi):
        out = exact(body, posed(body.skeleton, j1=[1, 0, 0, angle]))
        middle = out[strong.vertices[7]]
        widths.append(np.linalg.norm(middle[0] - middle[8]))
    assert widths[0] == pytest.approx(0.5) and widths[3] == pytest.approx(0.5 * 1.3)
    assert np.all(np.diff(widths) > 0)
