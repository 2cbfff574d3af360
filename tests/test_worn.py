"""Clothes in layers on a moving body: closed forms, twins of the kernels, what may not change."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import vitruvian as vt
from vitruvian.cli import app
from vitruvian.cloth import layers, layers_numpy, limbs, moving, proof, rough, wear, worn
from vitruvian.cloth.binding import bind
from vitruvian.cloth.drafting import drafted
from vitruvian.cloth.fabric import fabric
from vitruvian.cloth.moving import Skin, feet
from vitruvian.cloth.sheet import Sheet
from vitruvian.cloth.tailor import tailor
from vitruvian.deform.deformer import deformer
from vitruvian.deform.normals import incidence, mesh_normals
from vitruvian.errors import VitruvianError
from vitruvian.formats.garment_file import Kept, read_garment, write_garment
from vitruvian.modeling.measures import measures
from vitruvian.native import kernels
from vitruvian.show.proof_view import sheet

RADIUS, ROOM = 0.05, 0.015
rng = np.random.default_rng(8)


def tube(radius, *, length=0.4, around=48, along=40):
    """Vertices and triangles of an open tube along x, facing outwards."""
    turn, x = np.arange(around) * 2 * np.pi / around, np.linspace(0, length, along + 1)
    grid = np.stack(np.broadcast_arrays(x[:, None], radius * np.cos(turn), radius * np.sin(turn)), axis=2).reshape(
        -1, 3
    )
    a = (np.arange(along)[:, None] * around + np.arange(around)).ravel()
    b = (np.arange(along)[:, None] * around + (np.arange(around) + 1) % around).ravel()
    triangles = np.concatenate([np.stack([a, b, a + around], 1), np.stack([b, b + around, a + around], 1)])
    return grid, triangles.astype(np.int32)


def skin_of(points, triangles):
    points = points.astype(np.float32)
    normals = mesh_normals(incidence(points.astype(float), triangles), points[None])[0]
    return Skin(points, normals, triangles, np.zeros(len(points), np.int8))


def cloth_of(points, triangles):
    return Sheet(triangles, rough._flat(points[triangles]), np.zeros(len(triangles), np.int32), (fabric("cotton"),))


def sleeve(*, gravity=(0, -9.81, 0), turn=None):
    """A ring of cloth about a limb that is laid by `turn`: the skin, the limb's joints, the cloth, its half-balls."""
    turn = np.eye(3) if turn is None else turn
    inner, triangles = tube(RADIUS)
    outer, _ = tube(RADIUS + ROOM)
    skin, x = skin_of(inner @ turn.T, triangles), outer @ turn.T
    joints = np.array([[0, 0, 0], [0.4, 0, 0]]) @ turn.T
    binding = bind(skin.points.astype(float), triangles, x, normals=skin.normals.astype(float))
    every, far = np.ones(len(x), bool), np.full(len(x), 16)
    made = limbs.made(
        cloth_of(x, triangles), x, binding, every, every, np.zeros(len(x), int), np.array([[0, 1]]), joints, far,
        np.full(len(x), limbs.LEAST), skin, gravity, 3,
    )  # fmt: skip
    return skin, joints, x, made


def hang(skin, joints, x, made, *, frames=240, gravity=(0, -9.81, 0), speed=0.0):
    foot, up, _ = feet(skin, made.corner, made.share, made.fold)
    state, shift = limbs.begun(x, foot), np.zeros(3, np.float32)
    for _ in range(frames):
        step = np.array([speed / 60, 0, 0], np.float32)
        state = limbs.hung(made, state, foot + shift, foot + shift + step, up, joints, 1 / 60, gravity, None)
        shift += step
    return state[0], up


def test_a_sleeve_hangs_on_a_level_limb_as_a_ring_does():
    skin, joints, x, made = sleeve()
    r, up = hang(skin, joints, x, made)
    middle = (x[:, 0] > 0.1) & (x[:, 0] < 0.3)
    gap = np.einsum("kx,kx->k", r, up)[middle]
    down = -up[middle, 1]
    exact = ROOM * down + np.sqrt((RADIUS + ROOM) ** 2 - ROOM**2 * (1 - down**2)) - RADIUS
    below, side, above = down > 0.999, np.abs(down) < 0.05, down < -0.999
    assert gap[below].mean() == pytest.approx(2 * ROOM, rel=0.02)
    assert np.abs(gap[above]).max() <= limbs.LEAST + 1e-6
    # beside the limb the cloth may be as far away as the ring says, and not farther
    assert layers_numpy.reach(
        up[middle][side].astype(float), np.tile([1.0, 0, 0], (side.sum(), 1)), np.array([0, -9.81, 0]),
        np.full(side.sum(), RADIUS), np.full(side.sum(), ROOM), np.zeros(side.sum()),
    ) == pytest.approx(exact[side], abs=1e-6)  # fmt: skip
    assert exact[np.abs(down).argmin()] == pytest.approx(0.013246, abs=2e-4)
    assert (np.linalg.norm(r[middle], axis=1) <= np.maximum(exact, limbs.LEAST) + 1e-6).all()


def test_about_an_upright_limb_there_is_the_room_all_around():
    upright = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    skin, joints, x, made = sleeve(turn=upright)
    n = skin.normals[:10].astype(float)
    axis = np.tile([0.0, 1, 0], (10, 1))
    far = layers_numpy.reach(n, axis, np.array([0, -9.81, 0]), np.full(10, RADIUS), np.full(10, ROOM), np.zeros(10))
    assert far == pytest.approx(np.full(10, ROOM))
    none = layers_numpy.reach(n, axis, np.zeros(3), np.full(10, RADIUS), np.full(10, ROOM), np.zeros(10))
    assert none == pytest.approx(np.full(10, ROOM))


def test_even_motion_is_as_rest():
    made = sleeve()
    still, _ = hang(*made)
    carried, _ = hang(*made, speed=3.0)
    assert np.abs(still - carried).max() < 1e-5


def test_a_sleeve_comes_to_lie_as_it_was_draped():
    skin, joints, x, made = sleeve()
    bent = x + 0.004 * np.sin(40 * x[:, :1]) * (x * [0, 1, 1]) / (RADIUS + ROOM)  # folds
    binding = bind(skin.points.astype(float), skin.triangles, bent, normals=skin.normals.astype(float))
    sheet, every = cloth_of(bent, skin.triangles), np.ones(len(x), bool)
    made = limbs.made(
        sheet, bent, binding, every, every, np.zeros(len(x), int), np.array([[0, 1]]), joints, np.full(len(x), 16),
        np.full(len(x), limbs.LEAST), skin, (0, -9.81, 0), 3,
    )  # fmt: skip
    r, _ = hang(skin, joints, bent, made, frames=limbs.SETTLING)
    out = bent.astype(np.float32)
    limbs.placed(made, (r, np.zeros_like(r)), out, skin)
    assert np.abs(out - bent).max() < 1e-4


def body(count=400):
    """A bumpy skin, and cloth over it: some tight, some loose, some floating."""
    inner, triangles = tube(0.15, length=0.6, around=40, along=30)
    outer, _ = tube(0.15, length=0.6, around=40, along=30)
    height = np.interp(inner[:, 0], [0, 0.15, 0.25, 0.4, 0.45, 0.6], [0.004, 0.004, 0.02, 0.02, 0.06, 0.08])
    x = outer + height[:, None] * outer * [0, 1, 1] / 0.15
    return skin_of(inner, triangles), x, triangles


def garment(skin, x, triangles):
    binding = bind(skin.points.astype(float), skin.triangles, x, triangles, skin.normals.astype(float))
    known = layers.Anatomy(("trunk",), np.zeros(1, int), np.ones((1, 1), bool), np.full((1, 2), -1))
    layer = layers.sort(binding, x, triangles, np.zeros(len(skin.points), int), known)
    zero = np.zeros(len(x), int)
    made = worn.made(
        cloth_of(x, triangles), x, binding, layer, zero, known.bones, skin, np.zeros((1, 3)),
        np.full(len(x), 0.003),
    )  # fmt: skip
    return made, binding


@pytest.fixture(scope="module")
def shirt():
    skin, x, triangles = body()
    return (skin, x, *garment(skin, x, triangles))


def test_layers_follow_the_distance(shirt):
    skin, x, made, binding = shirt
    height = binding.offset[:, 2]
    assert set(made.layer[height < 0.007]) == {layers.TIGHT} and set(made.layer[height > 0.045]) == {layers.FLOATING}
    assert set(made.layer[(height > 0.012) & (height < 0.035)]) == {layers.LOOSE}
    assert sum(layers.counts(made.layer).values()) == len(x) and min(layers.counts(made.layer).values()) > 100


def test_paint_and_thresholds_decide(shirt):
    skin, x, _, binding = shirt
    known = layers.Anatomy(("trunk",), np.zeros(1, int), np.ones((1, 1), bool), np.full((1, 2), -1))
    zero = np.zeros(len(skin.points), int)
    layer = layers.sort(binding, x, skin.triangles, zero, known, edges={"trunk": (0.05, 0.05)}, painted={7: 2})
    assert layer[7] == layers.FLOATING and (layer == layers.LOOSE).sum() == 0
    with pytest.raises(VitruvianError, match="painted"):
        layers.sort(binding, x, skin.triangles, zero, known, painted={7: 3})
    with pytest.raises(VitruvianError, match="tight before loose"):
        layers.sort(binding, x, skin.triangles, zero, known, edges={"trunk": (0.05, 0.01)})


def test_at_rest_everything_lies_as_it_was_bound(shirt):
    skin, x, made, _ = shirt
    now = worn.begun(made, skin, np.zeros((1, 3)))
    assert np.abs(now.x - x).max() < 1e-6
    state = now.rough
    placed = now.x.copy()
    rough.placed(made.rough, state, placed, now.foot, now.up)
    assert np.abs(placed - x).max() < 1e-5


def test_tight_cloth_keeps_its_offset_on_any_skin(shirt):
    skin, x, made, binding = shirt
    bent = skin.points + 0.05 * np.sin(6 * skin.points[:, :1]) * [0, 1, 0.5] + 0.02 * rng.normal(size=3)
    other = skin_of(bent, skin.triangles)
    now = worn.moved(made, worn.begun(made, skin, np.zeros((1, 3))), other, np.full((1, 3), 0.01))
    tight = made.layer == layers.TIGHT
    far = np.linalg.norm(now.x - now.foot, axis=1)
    assert np.abs(far - np.linalg.norm(binding.offset, axis=1))[tight].max() < 1e-6


def test_the_rough_mesh_turns_with_the_body(shirt):
    skin, x, made, _ = shirt
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    other = skin_of(skin.points @ turn.T + [0.1, 0.2, 0.3], skin.triangles)
    now = worn.begun(made, other, np.zeros((1, 3)))
    rough.placed(made.rough, now.rough, now.x, now.foot, now.up)
    assert np.abs(now.x - (x @ turn.T + [0.1, 0.2, 0.3])).max() < 1e-5


def walked(made, skin, frames=20, speed=1.4):
    now = worn.begun(made, skin, np.zeros((1, 3)))
    out = []
    for k in range(1, frames + 1):
        shift = np.array([0.02 * np.sin(0.4 * k), 0, speed * k / 60])
        now = worn.moved(made, now, skin.at((skin.points + shift).astype(np.float32), skin.normals), shift[None])
        out.append(now.x)
    return out


def test_the_same_motion_gives_the_same_bits(shirt):
    skin, _, made, _ = shirt
    a, b = walked(made, skin), walked(made, skin)
    assert all(np.array_equal(p, q) for p, q in zip(a, b))


def test_layers_meet_without_gaps(shirt):
    """What is beside a border moves no farther apart than cloth stretches."""
    skin, x, made, _ = shirt
    edges = made.sheet.edges
    rest = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
    across = made.layer[edges[:, 0]] != made.layer[edges[:, 1]]
    for now in walked(made, skin):
        long = np.linalg.norm(now[edges[:, 0]] - now[edges[:, 1]], axis=1)
        assert (long[across] / rest[across]).max() < 1.35


def test_a_body_put_elsewhere_takes_its_clothes_along(shirt):
    skin, x, made, _ = shirt
    now = worn.begun(made, skin, np.zeros((1, 3)))
    there = skin.at(skin.points + np.float32(5), skin.normals)
    now = worn.moved(made, now, there, np.full((1, 3), 5.0))
    assert np.abs(now.x - x - 5).max() < 1e-5


def test_long_frames_are_survived(shirt):
    skin, x, made, _ = shirt
    now = worn.begun(made, skin, np.zeros((1, 3)))
    for k in range(1, 6):
        shift = np.array([0, 0, 0.3 * k])
        now = worn.moved(
            made, now, skin.at((skin.points + shift).astype(np.float32), skin.normals), shift[None], dt=0.25
        )
        assert np.linalg.norm(now.x - x - shift, axis=1).max() < 0.3
    with pytest.raises(VitruvianError, match="dt"):
        worn.moved(made, now, skin, np.zeros((1, 3)), dt=0)


def test_wind_moves_what_is_loose(shirt):
    skin, _, made, _ = shirt
    still = blown = worn.begun(made, skin, np.zeros((1, 3)))
    for _ in range(15):
        still = worn.moved(made, still, skin, np.zeros((1, 3)))
        blown = worn.moved(made, blown, skin, np.zeros((1, 3)), wind=(0, 0, 6.0))
    way = (blown.x - still.x)[made.layer == layers.FLOATING, 2]
    assert way.mean() > 0.002
    assert np.array_equal(blown.x[made.layer == layers.TIGHT], still.x[made.layer == layers.TIGHT])


@pytest.mark.skipif(kernels() is None, reason="the extension is not built: pip install .")
def test_kernels_do_what_their_twins_do():
    native = kernels()
    for k in range(60):
        n, count = int(rng.integers(1, 80)), 50
        point, normal = rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        corner = np.stack([rng.choice(count, 3, replace=False) for _ in range(n)]).astype(np.int32)
        share = rng.dirichlet(np.ones(3), n)
        single = [a.astype(np.float32) for a in (point, normal, share, 0.1 * rng.normal(size=(n, 3)))]
        point, normal, share, offset = single
        ours, theirs = ([np.zeros((n, 3), np.float32) for _ in range(3)] for _ in range(2))
        native.cloth_feet(point, normal, corner, share, offset, *ours)
        layers_numpy.cloth_feet(point, normal, corner, share, offset, *theirs)
        assert all(np.abs(a - b).max() < 2e-5 for a, b in zip(ours, theirs))
        pairs = [rng.choice(n, rng.integers(0, min(n, 5) + 1), replace=False) for _ in range(n)]
        row = np.cumsum([0, *map(len, pairs)]).astype(np.int32)
        neighbour = np.concatenate([np.zeros(0, np.int32), *pairs]).astype(np.int32)
        foot, up = ours[0], theirs[1]
        axis = rng.normal(size=(3, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        numbers = np.array(
            [1 / 60, 4, 0.4, 0.3, 0.72, 0.15 if k % 2 else 0, *rng.normal(size=3) * 9, *rng.normal(size=3) * 5]
        )
        arrays = (
            np.arange(n, dtype=np.int32), rng.integers(0, 3, n).astype(np.int32), rng.uniform(0.03, 0.1, n),
            rng.uniform(0, 0.03, n), np.full(n, 0.003), row, neighbour, foot + 0.01 * rng.normal(size=(n, 3)), foot, up,
            axis, 0 * numbers if k == 0 else numbers,
        )  # fmt: skip
        arrays = [a if a.dtype == np.int32 else a.astype(np.float32) for a in arrays]
        arrays[-1][0] = 1 / 60
        r, v = (0.02 * rng.normal(size=(n, 3))).astype(np.float32), rng.normal(size=(n, 3)).astype(np.float32)
        r2, v2 = r.copy(), v.copy()
        native.cloth_limbs(r, v, *arrays)
        layers_numpy.cloth_limbs(r2, v2, *arrays)
        assert np.abs(r - r2).max() < 2e-5 and np.abs(v - v2).max() < 5e-3, k


def test_a_rough_mesh_is_a_thinned_one(shirt):
    skin, x, made, _ = shirt
    seeds, coarse = rough.thinned(x, skin.triangles, np.ones(len(x), bool), 120)
    assert 60 < len(seeds) < 240 and coarse.max() < len(seeds)
    corners = x[seeds][coarse]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    fine = x[skin.triangles]
    whole = 0.5 * np.linalg.norm(np.cross(fine[:, 1] - fine[:, 0], fine[:, 2] - fine[:, 0]), axis=1).sum()
    assert area == pytest.approx(whole, rel=0.1)  # no holes, no doubles


def test_replaced_layers_are_not_simulated(shirt):
    skin, x, made, _ = shirt
    bare = replace(made, limbs=None, rough=None, floating=None)
    now = worn.moved(bare, worn.begun(bare, skin, np.zeros((1, 3))), skin, np.zeros((1, 3)))
    assert np.abs(now.x - x).max() < 1e-6


def test_what_got_into_the_skin_is_put_out_of_it(monkeypatch):
    inner, triangles = tube(RADIUS)
    skin = skin_of(inner, triangles)
    for k in range(20):
        n, turn = 400, rng.uniform(0, 2 * np.pi, 400)
        high = RADIUS + rng.uniform(-0.009, 0.01, n)
        x = np.stack([rng.uniform(0.05, 0.35, n), high * np.cos(turn), high * np.sin(turn)], axis=1).astype(np.float32)
        some = np.sort(rng.choice(n, 300, replace=False)).astype(np.int32)
        near = np.argmin(((x[some, None] - inner[triangles].mean(axis=1)) ** 2).sum(axis=2), axis=1).astype(np.int32)
        ours = x.copy()
        moving.clear(ours, some, near, skin, 0.002)
        others = np.setdiff1d(np.arange(n), some)
        assert np.array_equal(ours[others], x[others])
        chord = RADIUS * np.cos(np.pi / 48)
        assert np.linalg.norm(ours[some, 1:], axis=1).min() > chord + 0.002 - 1e-6
        away = high[some] > RADIUS + 0.0021
        assert np.array_equal(ours[some][away], x[some][away])
        theirs = x.copy()
        with monkeypatch.context() as m:
            m.setattr(moving, "kernels", lambda: None)
            moving.clear(theirs, some, near, skin, 0.002)
        shallow = high > RADIUS - 0.001  # deeper inside, the nearest of a ring of triangles is a matter of taste
        assert np.quantile(np.abs(ours - theirs)[shallow].max(axis=1), 0.98) < 1e-6, k


def test_a_border_that_jumps_is_seen():
    edges = np.array([[0, 1], [1, 2], [2, 3]])
    layer = np.array([0, 0, 2, 2])
    x = np.zeros((3, 4, 3), np.float32)
    x[1:, :, 0] = 0.01  # all together, then nothing
    assert proof.jumps(edges, layer, x) == pytest.approx(1)
    x[2, 2, 1] = 0.05  # one that has a border, alone
    assert proof.jumps(edges, layer, x) == pytest.approx(0.05 / proof.STILL)
    assert proof.jumps(edges, np.zeros(4, int), x) == 0  # without borders none jumps


@pytest.fixture(scope="module")
def skirted():
    """A person, her body, and a coarse skirt."""
    person = vt.person(outfit=None, hair="none", loa=1)
    body = vt.pack(person)
    return person, body, tailor(drafted("skirt", measures(person).values), body, size=0.03)


def test_clothes_go_on_when_a_walk_begins_again(skirted):
    person, body, made = skirted
    clip = vt.Clip(person, body, vt.walk(body.skeleton, cycles=1), garment=made)
    stage = vt.Stage([clip], rate=60)
    cloth = next(n for n, a in stage.actors.items() if a.on is not None)
    places, rounds, rate = [], [], 60
    for _ in range(2 * rate + 10):
        frame = stage.step()
        places.append(frame[cloth].points)
        rounds.append(stage.actors[cloth].on.round)
    assert max(rounds) >= 1  # once round
    way = np.linalg.norm(np.diff(np.array(places), axis=0), axis=2)
    mean, new = way.mean(axis=1), np.flatnonzero(np.diff(rounds))
    assert all(mean[k] < 2 * np.median(mean) for k in new)
    assert np.ptp(np.array(places).mean(axis=1)[:, 2]) > 1  # she has come somewhere, and her skirt with her


def test_a_proof_compares_with_the_full_simulation(skirted, tmp_path):
    person, body, made = skirted
    who = wear.wearer(deformer("log", body))
    prepared = wear.wear(made, who)[-1]
    matrices = vt.joint_matrices(body.skeleton, vt.walk(body.skeleton, cycles=1))[:6]
    found = proof.proven(prepared, who, matrices, dt=1 / 30)
    n = len(made.vertices)
    assert found.layered.shape == found.full.shape == (6, n, 3) and found.far.shape == found.off.shape == (6, n)
    assert (found.off <= found.far + 1e-6).all() and 0 < found.off.mean() < 0.03
    figures = found.summary()
    assert sum(figures["vertices"].values()) == n and figures["share"] > 0
    skins = [who.at(m)[0].points for m in matrices]
    pixels = sheet(found, skins, who.skin.triangles, made.triangles, tmp_path / "proof.png", height=160)
    colored = np.abs(pixels.astype(int) - pixels.mean(axis=2, keepdims=True)).max(axis=2) > 40
    assert colored.mean() > 0.01 and (tmp_path / "proof.png").stat().st_size > 5000
    with pytest.raises(VitruvianError, match="png"):
        sheet(found, skins, who.skin.triangles, made.triangles, tmp_path / "proof.jpg")


@pytest.mark.parametrize(
    ("more", "said"), [(["--proof", "x.pdf"], ".png or .json"), (["--proof", "x.png"], "--garment")]
)
def test_proofs_that_cannot_be_are_refused(more, said, tmp_path):
    args = ["animate", "person", "walk", "-o", str(tmp_path / "x.glb"), *more]
    done = CliRunner().invoke(app, args + (["--garment", "tshirt"] if said.startswith(".") else []))
    assert done.exit_code != 0 and isinstance(done.exception, VitruvianError) and said in str(done.exception)


def test_what_was_found_out_is_kept_with_the_garment(skirted, tmp_path):
    """The second time, and from its file, a garment is ready at once, and the same to the bit."""
    _, body, made = skirted
    who = wear.wearer(deformer("log", body))
    prepared = wear.wear(made, who)
    kept = wear.hung(prepared)
    assert made.hung is None and np.array_equal(kept.hung.layer, prepared[-1].worn.layer)
    write_garment(Kept(kept, body.skin.rest, body.skin.triangles), tmp_path / "skirt.garment.npz")
    read = read_garment(tmp_path / "skirt.garment.npz").garment
    (again,) = wear.wear(read, who)
    assert np.array_equal(again.x, prepared[-1].x) and np.array_equal(again.worn.layer, prepared[-1].worn.layer)
    assert np.array_equal(again.worn.offset, prepared[-1].worn.offset)
    (other,) = wear.wear(read, who, edges={name: (0.0, 0.001) for name in who.known.names})
    assert (other.worn.layer == layers.FLOATING).mean() > (again.worn.layer == layers.FLOATING).mean()
    bad = {**np.load(tmp_path / "skirt.garment.npz")} | {"layer": np.full(len(kept.vertices), 7)}
    np.savez(tmp_path / "bad.garment.npz", **bad)
    with pytest.raises(VitruvianError, match="layer"):
        read_garment(tmp_path / "bad.garment.npz")
