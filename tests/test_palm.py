"""The palm of a hand: which areas swell, that nothing steps where they meet, and how much of the volume is kept."""

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.hands import Hand, Rounding
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Skeleton, Skin, Weights
from vitruvian.deform import hands
from vitruvian.deform.deformer import deformer
from vitruvian.deform.hand_links import hands_of
from vitruvian.motion.types import Motion

SPREAD = 0.02  # metres between metacarpals
LENGTH = 0.07
STEP = 1e-9


@pytest.fixture(params=["kernel", "twin"])
def engine(request, monkeypatch):
    if request.param == "twin":
        monkeypatch.setattr(hands, "kernels", lambda: None)


def palm(rest, rounding, arch=0.0, count=4, triangles=None):
    """Metacarpals along -y, side by side along x, the back of the hand -z; the inner ones stand `arch` (m) higher."""
    x = (np.arange(count) - (count - 1) / 2) * SPREAD
    high = arch * (1 - (x / np.abs(x).max()) ** 2)
    start = np.stack([0.8 * x, np.zeros(count), -high], axis=1)
    end = np.stack([x, np.full(count, -LENGTH), -high], axis=1)
    skeleton = Skeleton(tuple("wabcd"[: count + 1]), np.array([-1] + [0] * count), np.vstack([[0, 0.02, 0], start]))
    along = (end - start) / np.linalg.norm(end - start, axis=1)[:, None]
    axis = np.cross([0, 0, -1.0], along)
    number = np.arange(count)
    beside = np.stack([number - 1, np.where(number + 1 < count, number + 1, -1)], axis=1)
    hand = Hand(
        "palm", np.zeros(count), number + 1, np.full(count, -1), start, end, axis / np.linalg.norm(axis, axis=1)[:, None],
        axis / np.linalg.norm(axis, axis=1)[:, None], beside, np.arange(len(rest)), np.ones(len(rest)),
        (rounding,) * count,
    )  # fmt: skip
    n = len(rest)
    faces = np.zeros((0, 3), np.int32) if triangles is None else triangles
    return skeleton, Skin(rest, faces, Weights.from_pairs(n, np.arange(n), np.zeros(n), np.ones(n))), hand


def cupped(skeleton, roll=0.25, flex=0.5):
    """Outer metacarpals turned about the length of the palm towards each other, and bent."""
    q = np.tile([0.0, 0, 0, 1], (1, len(skeleton), 1))
    for j in range(1, len(skeleton)):
        side = np.sign(skeleton.centers[j, 0]) * (abs(skeleton.centers[j, 0]) > SPREAD / 2)
        turn = np.array([flex * (0.4 + 0.1 * j), 0.0, 0.0]) + roll * side * np.array([0.2, 1.0, -0.5])
        size = np.linalg.norm(turn)
        q[0, j] = from_axis_angle([*(turn / size), size])
    return joint_matrices(skeleton, Motion(skeleton, 30.0, q, np.zeros((1, 3))))


def nearer(amount):
    """Two metacarpals, one moved towards the other."""
    m = np.tile(np.eye(4), (1, 3, 1, 1))
    m[0, 2, 0, 3] = -amount
    return m


def placed(rest, rounding, matrices, dtype=np.float64, plain=False, **how):
    _, skin, hand = palm(rest, rounding, **how)
    out = np.repeat(skin.rest[None], len(matrices), axis=0).astype(dtype)
    hands.place(hands.hand_program(hand, skin, plain=plain), matrices, out)
    return out.astype(np.float64)


INSIDE, BACK = [0.0, -LENGTH / 2, 0.01], [0.0, -LENGTH / 2, -0.01]


@pytest.mark.parametrize("share, inner", [(0, 1.0), (0.5, 1.2), (1, 1.4)])
def test_the_gap_swells_outside_and_by_choice_inside(engine, share, inner):
    """F 0.5 and A_m 0.4: 1 + 0.4 (1/0.5 - 1) = 1.4 on the back. F 0.2, A_m 1 reaches the cap of 2."""
    rest, still = np.array([INSIDE, BACK]), np.tile(np.eye(4), (1, 3, 1, 1))
    how = {"count": 2, "dtype": np.float32}
    gap = hands.hand_program(*reversed(palm(rest, Rounding(), count=2)[1:]))
    half = 0.5 * gap.width[0]  # links fan out a little
    thick = lambda r, m: np.abs(placed(rest, r, m, **how)[0, :, 2]) / 0.01  # noqa: E731
    assert thick(Rounding(muscle=0.4, palm=share), still) == pytest.approx([1, 1], abs=1e-6)
    assert thick(Rounding(muscle=0.4, palm=share), nearer(half)) == pytest.approx([inner, 1.4], abs=1e-5)
    assert thick(Rounding(muscle=0.4, palm=share), nearer(-half)) == pytest.approx([1, 1], abs=1e-6)  # they part
    assert thick(Rounding(muscle=1, palm=share), nearer(1.6 * half)) == pytest.approx(
        [1 + min(share * 4, 1), 2], abs=1e-5
    )
    first = placed(rest, Rounding(muscle=1, palm=share), nearer(half), plain=True, **how)
    assert np.array_equal(first, placed(rest, Rounding(0, muscle=0, palm=share, arc=0), nearer(half), **how))


def test_the_inner_side_of_a_bone_swells_only_by_choice(engine):
    """On the metacarpal itself, bent by a quarter turn at its beginning: 1 + A_m (1 - cos 45) at its middle."""
    angle = np.pi / 2

    def thickness(rounding):
        skeleton, skin, hand = palm(np.array([[-SPREAD / 2 * 0.9, -LENGTH / 2, 0.004]]), rounding, count=2)
        q = np.tile([0.0, 0, 0, 1], (1, 3, 1))
        q[0, 1] = from_axis_angle([*hand.axis_near[0], angle])
        q[0, 2] = from_axis_angle([*hand.axis_near[1], angle])
        m = joint_matrices(skeleton, Motion(skeleton, 30.0, q, np.zeros((1, 3))))
        out = skin.rest[None].astype(np.float32)
        hands.place(hands.hand_program(hand, skin), m, out)
        p, d = (m[0, 1, :3, :3] @ v for v in (hand.start[0], hand.end[0] - hand.start[0]))
        off = out[0, 0] - (p + m[0, 1, :3, 3])
        return np.linalg.norm(off - (off @ d) / (d @ d) * d)

    plain = thickness(Rounding(muscle=0.4, arc=0))
    assert thickness(Rounding(muscle=0, arc=0)) == pytest.approx(plain, abs=1e-9)
    want = 1 + 0.4 * (1 - np.cos(angle / 2))
    assert thickness(Rounding(muscle=0.4, arc=0, palm=1)) == pytest.approx(plain * want, rel=2e-3)


@pytest.mark.parametrize("rounding", [Rounding(0.8, muscle=0.7, palm=p, arc=a) for a in (0, 1) for p in (0, 1)])
@pytest.mark.parametrize("arch", [0.0, 0.009])
def test_nothing_steps_where_areas_of_the_palm_meet(rounding, arch):
    """Ways over the palm, outside, inside and through it: as fine as steps are, points beside each other stay so."""
    skeleton, _, _ = palm(np.zeros((1, 3)), rounding, arch)
    m = cupped(skeleton)
    rng = np.random.default_rng(5)
    for _ in range(6):
        ends = rng.uniform([-0.03, -LENGTH * 0.98, -0.025], [0.03, -0.03, 0.02], (2, 3))
        way = ends[1] - ends[0]
        rate = 0.0
        t = np.linspace(0, 1, 4001)
        for _ in range(4):  # ever closer to where it changes fastest
            points = ends[0] + t[:, None] * way
            out = placed(points, rounding, m, arch=arch)[0]
            moved = np.linalg.norm(np.diff(out, axis=0), axis=1) / np.maximum(np.diff(t), 1e-300) / np.linalg.norm(way)
            k, before, rate = int(np.argmax(moved)), rate, float(moved.max())
            t = np.linspace(t[max(k - 1, 0)], t[min(k + 2, len(t) - 1)], 401)
        assert rate < max(2 * before, 1.0) and rate < 60, (ends, rate, before)


def hull(rings=41, around=96):
    """A closed palm about the metacarpals: its thickness 24 mm, its width 84 mm."""
    turn = np.linspace(0, 2 * np.pi, around, endpoint=False)
    y = np.repeat(np.linspace(-0.01, -LENGTH + 0.002, rings), around)
    x, z = (
        0.042 * np.tile(np.cos(turn), rings),
        0.012 * np.tile(np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** 0.5, rings),
    )
    rest = np.concatenate([np.stack([x, y, z], axis=1), [[0, y[0], 0], [0, y[-1], 0]]])
    i = np.arange(rings * around).reshape(rings, around)
    a, b, c, d = i[:-1], np.roll(i, -1, 1)[:-1], np.roll(i, -1, 1)[1:], i[1:]
    first, last = np.full(around, rings * around), np.full(around, rings * around + 1)
    faces = [np.stack(f, -1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))]
    faces += [np.stack([first, np.roll(i[0], -1), i[0]], -1), np.stack([last, i[-1], np.roll(i[-1], -1)], -1)]
    return rest, np.concatenate(faces).astype(np.int32)


def volume(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return abs(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def test_a_cupped_palm_keeps_its_volume_better_when_its_inner_side_swells():
    rest, faces = hull()
    before = volume(rest, faces)
    kept = {}
    for share in (0.0, 0.5, 1.0):
        m = cupped(palm(rest, Rounding())[0], roll=0.25, flex=0.2)
        kept[share] = volume(placed(rest, Rounding(muscle=0.6, palm=share), m)[0], faces) / before
    assert 0.85 < kept[0] < kept[0.5] - 0.005 < kept[1] - 0.01 < 1, kept


@pytest.fixture(scope="module")
def body():
    return vt.pack(vt.person())


def test_the_persons_palms_are_the_same_in_the_kernel_and_its_twin(body, monkeypatch):
    """Closed, with metacarpals folded; and `palm` moves only the inner side of the palm."""
    q = np.tile([0.0, 0, 0, 1], (1, len(body.skeleton), 1))
    for hand in hands_of(body):
        for link, j in enumerate(hand.near.tolist()):
            q[0, j] = from_axis_angle([*hand.axis_near[link], 0.25 if (hand.beside[link] >= 0).any() else 0.9])
    m = joint_matrices(body.skeleton, Motion(body.skeleton, 30.0, q, np.zeros((1, 3))))
    chosen = {"": Rounding(muscle=0.8, palm=1.0)}
    d = deformer("hand", body, hands=chosen)
    out, without = d(m)[0], deformer("hand", body, hands={"": Rounding(muscle=0.8)})(m)[0]
    moved = np.flatnonzero(np.abs(out - without).max(axis=1) > 1e-5)
    left, right = hands_of(body)
    assert len(moved) > 200 and set(moved.tolist()) <= {*left.vertices.tolist(), *right.vertices.tolist()}
    for hand in (left, right):
        program, middle = hands.hand_program(hand, body.skin), int(np.flatnonzero((hand.beside >= 0).all(axis=1))[0])
        own = np.intersect1d(moved, hand.vertices)
        assert ((body.skin.rest[own] - hand.start[middle]) @ program.normal_own[middle] < 0.003).all()
    monkeypatch.setattr(hands, "kernels", lambda: None)
    assert np.abs(deformer("hand", body, hands=chosen)(m)[0] - out).max() < 1e-6
