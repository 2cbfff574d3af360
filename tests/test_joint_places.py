"""Where the built-in person's joints lie: at the skin that bends about them, whoever the person is."""

import numpy as np
import pytest

from vitruvian.modeling import anatomy, source
from vitruvian.modeling.person import humanoid_of, weight_matrix
from vitruvian.modeling.shape import Shape, shaped

NAMES = list(anatomy.names())
LIMBS = {"hip": "knee", "knee": "talocrural", "shoulder": "elbow", "elbow": "radiocarpal"}
FINGERS = {
    f"{kind}_{ray}": f"{kind.replace('proximal', 'distal')}_{ray}" if "proximal" in kind else None
    for kind in ("carpal_proximal_interphalangeal", "carpal_distal_interphalangeal")
    for ray in (2, 3, 4, 5)
}


def below():
    """(13380,146) how much of a vertex moves with a joint or those below it."""
    out = weight_matrix()[: source.BODY].toarray()
    for i in range(len(NAMES) - 1, 0, -1):
        out[:, anatomy.parents()[i]] += out[:, i]
    return out


BELOW = below()


def people(count, seed, **fixed):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        free = {n: rng.random() for n in ("gender", "muscle", "weight", "height", "proportions", "cup")}
        yield Shape(**({"age": rng.uniform(10, 90), "origin": tuple(rng.random(3) + 0.01)} | free | fixed))


def along(points, name, after):
    """Metres from the centre of a joint on to where the skin's weights change over, along its bone; how long that is."""
    centers = anatomy.centers(points)
    here, there = (centers[NAMES.index("l_" + n)] for n in (name, after))
    inside = BELOW[:, NAMES.index("l_" + name)]
    share = inside * (1 - inside)
    length = float(np.linalg.norm(there - here))
    return float((share @ points[: source.BODY] / share.sum() - here) @ (there - here)) / length, length


def test_knees_and_elbows_follow_the_skin():
    """0.94 to 2.5 m tall, 10 to 90 years: the source's cubes lie up to 100 mm from where the skin bends, at knees."""
    usual = {n: along(shaped(Shape()), n, LIMBS[n])[0] for n in ("knee", "elbow")}
    ratios, arms = [], []
    for shape in people(60, 11):
        points = shaped(shape)
        scale = 1.66 / float(np.ptp(points[: source.BODY, 1]))
        for name, most in (("knee", 0.006), ("elbow", 0.012)):
            assert abs(along(points, name, LIMBS[name])[0] - usual[name]) * scale < most, shape
        lengths = {n: along(points, n, LIMBS[n])[1] for n in LIMBS}
        ratios.append(lengths["knee"] / lengths["hip"])
        arms.append(lengths["elbow"] / lengths["shoulder"])
    # Shank over thigh between joint centres: 1.00 (Drillis and Contini 1966), 1.03 for men and more for women (P. de Leva
    # 1996), forearm over upper arm 0.95; people differ from the means by a tenth.
    assert min(ratios) > 0.88 and max(ratios) < 1.24 and 1.0 < np.mean(ratios) < 1.1
    assert min(arms) > 0.82 and max(arms) < 1.13 and 0.93 < np.mean(arms) < 1.0


def test_people_of_average_height_keep_their_joints():
    off = []
    for shape in people(25, 5, height=0.5, age=35.0):
        points = shaped(shape)
        cubes = source.array("centres").astype(np.float64) @ points[source.POINTS :]
        away = np.linalg.norm(anatomy.centers(points) - cubes, axis=1)
        assert not away[[NAMES.index(n) for n in ("l_hip", "l_talocrural", "l_shoulder", "l_radiocarpal")]].any()
        off.append([away[NAMES.index(n)] for n in ("l_knee", "l_elbow")])
    assert np.mean(off) < 0.007 and np.max(off) < 0.014


def test_left_is_right_and_small_steps_are_small():
    for shape in people(6, 3):
        centers = anatomy.centers(shaped(shape))
        for name in [n for n in NAMES if n.startswith("l_")]:
            mate = centers[NAMES.index("r_" + name[2:])]
            assert np.allclose(centers[NAMES.index(name)] * [-1, 1, 1], mate, atol=1e-5), name
    heights = np.linspace(0, 1, 101)
    path = np.stack([anatomy.centers(shaped(Shape(height=h))) for h in heights])
    assert np.linalg.norm(np.diff(path, axis=0), axis=2).max() < 0.02


@pytest.mark.parametrize("shape", [Shape(gender=0.0, age=30), Shape(gender=1.0, age=60, weight=0.9), Shape(age=10)])
def test_bones_of_fingers_lie_inside_them(shape):
    """Between a third and a half of the way from back to front, in the middle from side to side: they hang down here."""
    from trimesh import Trimesh

    humanoid = humanoid_of(shape, outfit=None)
    joints = {j.name: j.center for j in humanoid.joints()}
    body = Trimesh(humanoid.skin_coord[: source.BODY], source.array("triangles"), process=False)
    names = [f"l_{n}" for n in FINGERS]
    at = np.stack([joints[n] for n in names])
    ways = {"back": [1, 0, 0], "front": [-1, 0, 0], "one": [0, 0, 1], "other": [0, 0, -1]}  # palms face the thighs
    room = {}
    for way, direction in ways.items():
        hits, ray, _ = body.ray.intersects_location(at, np.tile(direction, (len(at), 1)), multiple_hits=True)
        far = np.linalg.norm(hits - at[ray], axis=1)
        room[way] = np.array([far[ray == i].min() for i in range(len(at))])
    assert (np.abs(room["back"] / (room["back"] + room["front"]) - 0.44) < 0.09).all()
    assert (np.abs(room["one"] / (room["one"] + room["other"]) - 0.5) < 0.14).all()
