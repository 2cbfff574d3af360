"""Clothes on a moving body in real time: tight cloth follows the skin, loose cloth hangs about limbs or on a rough mesh,
floating cloth is simulated.

Source: seed 003, section 5.3.2; note cloth.md, section 7. All of it is in humanoid space, metres and seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.types import Floats, Ints, floats, require
from vitruvian.cloth import limbs as about
from vitruvian.cloth import rough as roughly
from vitruvian.cloth.binding import Binding
from vitruvian.cloth.layers import FLOATING, LOOSE
from vitruvian.cloth.limbs import Limbs
from vitruvian.cloth.moving import Passing, Skin, clear, feet
from vitruvian.cloth.pinching import NOTHING, Pinched, given_way
from vitruvian.cloth.rough import Rough
from vitruvian.cloth.sheet import Sheet
from vitruvian.cloth.solver import FRAME, GRAVITY, Cloth, State, assemble, step

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Single = NDArray[np.float32]
STEPS = 12  # of a frame, for cloth that floats
BAND = 3  # rings of vertices over which one layer becomes the next
BACK = 0.1  # of the way from its foot that cloth comes back in a frame, when skin no longer closes in on it
JUMP = 0.5  # metres that a body moves in a frame when it is put elsewhere
ALONE = 0.002  # metres a frame that floating cloth may move beside what its neighbours do, and as much as those
LONGEST, MOST = 1 / 30, 8  # seconds of a frame; what takes longer is made up for in so many at most


@dataclass(frozen=True, eq=False)
class Floating:
    """The part that is simulated: vertices (k,) of the garment, those of its `cloth`, of which `border` are moved; home
    (k,): those that are bound to arms; free (f,): those that float;
    mean (f,k): of the neighbours of each."""

    vertices: Ints
    cloth: Cloth
    border: Ints
    home: NDArray[np.bool_]
    free: Ints
    mean: csr_array


@dataclass(frozen=True, eq=False)
class Worn:
    """A garment ready to be worn: its sheet, the layer (n,) of each vertex, corner, share and offset (n,3) by which all are
    bound to the skin, the vertices (k,) that are loose, the triangles (n,) of the skin beneath all, what moves each
    layer, and what skin may close in on."""

    sheet: Sheet
    layer: Ints
    corner: Ints
    share: Single
    offset: Single
    loose: Ints
    beneath: Ints
    limbs: Limbs | None
    rough: Rough | None
    floating: Floating | None
    close: Pinched


@dataclass(frozen=True, eq=False)
class Now:
    """Where a worn garment is: x (n,3) metres on a skin, what floating cloth meets, the feet (n,3) of its vertices
    and the normals there, the joints (J,3), the part (n,) of the way from its foot that skin leaves to each, and what each
    layer remembers."""

    x: Single
    skin: Skin
    met: Skin
    foot: Single
    up: Single
    joints: Floats
    part: Single
    limbs: tuple[Single, Single] | None = None
    rough: State | None = None
    floating: State | None = None


def made(
    sheet: Sheet, x: Floats, binding: Binding, layer: Ints, regions: Ints, bones: Ints, skin: Skin, joints: Floats,
    least: Floats, *, close: Pinched = NOTHING, gap: float = 0.0, gravity: ArrayLike = GRAVITY,
) -> Worn:  # fmt: skip
    """A garment made ready to be worn: a sheet draped at x (n,3) metres on a skin that it is bound to.

    layer (n,) and regions (n,) of its vertices, see `vitruvian.cloth.layers`; bones (R,2): the joints at the ends of each
    region's bone, or -1; joints (J,3) metres: where they are; least (n,) metres that loose cloth keeps from the
    skin; close: what skin comes to face; gap: metres that floating cloth keeps from itself, 0: none. Loose cloth on the
    trunk that nothing but floating cloth would hold floats, too.
    """
    x = floats(x, "x", len(layer), 3)
    hanging = (layer == LOOSE) & (bones[regions, 0] >= 0)
    unheld = _unheld(sheet.edges, (layer == LOOSE) & ~hanging, layer != FLOATING)
    layer = np.where(unheld, FLOATING, layer).astype(np.int32)
    loose = layer == LOOSE
    others = loose & ~hanging
    around = layer != FLOATING
    single = lambda a: np.ascontiguousarray(a, np.float32)  # noqa: E731
    return Worn(
        sheet, layer, np.ascontiguousarray(binding.triangles[binding.face], np.int32), single(binding.share),
        single(binding.offset), np.flatnonzero(loose).astype(np.int32), binding.face.astype(np.int32),
        about.made(sheet, x, binding, hanging, around, regions, bones, joints, rings(sheet.edges, around & ~hanging),
                   least, skin, gravity, BAND),
        roughly.made(sheet, x, np.minimum(least, binding.offset[:, 2]), others, around,
                     rings(sheet.edges, around & ~others), BAND),
        simulated(sheet, layer, gap, skin.side[binding.triangles[binding.face, 0]] > 0), close,
    )  # fmt: skip


def _unheld(edges: Ints, loose: NDArray[np.bool_], held: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) vertices of loose pieces without a neighbour that is `held` (n,) and not loose."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(loose)
    a, b = edges[loose[edges].all(axis=1)].T
    piece = connected_components(coo_array((np.ones(len(a)), (a, b)), (n, n)), directed=False)[1]
    found = np.zeros(n, bool)
    for p, q in (edges.T, edges[:, ::-1].T):
        found[piece[p[loose[p] & held[q] & ~loose[q]]]] = True
    return loose & ~found[piece]


def begun(worn: Worn, skin: Skin, joints: Floats, below: Skin | None = None) -> Now:
    """The garment as it is bound to a skin, at rest on it. joints (J,3) metres; below: see `moved`."""
    foot, up, x = feet(skin, worn.corner, worn.share, worn.offset)
    limbs, rough, floating = worn.limbs, worn.rough, worn.floating
    return Now(
        x, skin, skin if below is None else below, foot, up, joints, np.ones(len(x), np.float32),
        None if limbs is None else about.begun(x[limbs.vertices], foot[limbs.vertices]),
        None if rough is None else rough.cloth.state(x[rough.vertices]),
        None if floating is None else floating.cloth.state(x[floating.vertices]),
    )  # fmt: skip


def shifted(now: Now, by: Floats) -> Now:
    """The same elsewhere: all of it moved by (3,) metres, and as fast as it was."""
    if not np.any(by):
        return now
    b = np.asarray(by, np.float32)
    there = lambda s: None if s is None else replace(s, x=s.x + b)  # noqa: E731
    skin = now.skin.at(now.skin.points + b, now.skin.normals)
    met = skin if now.met is now.skin else now.met.at(now.met.points + b, now.met.normals)
    return replace(
        now, x=now.x + b, skin=skin, met=met, foot=now.foot + b, joints=now.joints + np.asarray(by, np.float64),
        rough=there(now.rough), floating=there(now.floating),
    )  # fmt: skip


def moved(
    worn: Worn, now: Now, skin: Skin, joints: Floats, *, dt: float = FRAME, gravity: ArrayLike = GRAVITY,
    wind: ArrayLike | None = None, steps: int = STEPS, below: Skin | None = None,
) -> Now:  # fmt: skip
    """The garment `dt` seconds later, on the skin as it is then. joints (J,3) metres; wind (3,) m/s; `steps` in a frame of
    what floats; below: the skin with what is worn below this, if anything is, which floating cloth meets instead.

    A body that is suddenly elsewhere takes its clothes with it, as they are bound to it; a long frame counts as several.
    """
    require(0 < dt < 10, "dt", "up to 10 seconds", dt)
    if np.linalg.norm(joints[0] - now.joints[0]) > JUMP * max(1.0, dt / FRAME):
        return begun(worn, skin, joints, below)
    pieces = min(MOST, int(np.ceil(dt / LONGEST - 1e-6)))
    start, first = now.skin, now.joints
    met, meets = now.met, skin if below is None else below
    for k in range(1, pieces + 1):
        share = k / pieces
        now = _moved(worn, now, start.toward(skin, share), met.toward(meets, share), first + share * (joints - first),
                     min(dt / pieces, LONGEST), gravity, wind, steps)  # fmt: skip
    return now


def _moved(
    worn: Worn,
    now: Now,
    skin: Skin,
    met: Skin,
    joints: Floats,
    dt: float,
    gravity: ArrayLike,
    wind: ArrayLike | None,
    steps: int,
) -> Now:
    foot, up, x = feet(skin, worn.corner, worn.share, worn.offset)
    limbs, rough, floating = now.limbs, now.rough, now.floating
    drift = (joints[0] - now.joints[0]) / dt
    if worn.limbs is not None and limbs is not None:
        some = worn.limbs.vertices
        limbs = about.hung(worn.limbs, limbs, now.foot[some], foot[some], up[some], joints, dt, gravity, wind)
        about.placed(worn.limbs, limbs, x, skin)
    if worn.rough is not None and rough is not None:
        rough = roughly.moved(worn.rough, rough, x, (now.foot, now.up), (foot, up), drift, dt, gravity, wind)
        roughly.placed(worn.rough, rough, x, foot, up)
    if worn.floating is not None and floating is not None:
        f = worn.floating
        slow = float(np.mean([c.damping for c in f.cloth.sheet.fabrics]))
        pull = np.asarray(gravity, np.float64) + slow * drift  # the air moves along: else clothes lag behind a walk
        before = floating.x
        floating = step(
            f.cloth, floating, dt=dt, substeps=steps, gravity=(pull[0], pull[1], pull[2]), damping=slow,
            targets=x[f.vertices[f.border]], obstacle=Passing(met, now.met, f.home), wind=wind,
        )  # fmt: skip
        own = f.vertices[f.free]
        _together(f, floating, before, dt)
        x[own] = floating.x[f.free]
        nearest = None if floating.nearest is None else floating.nearest[f.free]
        if nearest is not None:
            clear(x, own, nearest, met)
        clear(x, own, worn.beneath[own], skin)
    clear(x, worn.loose, worn.beneath[worn.loose], skin)
    part = now.part.copy()
    given_way(worn.close, x, part, foot, up, skin, BACK * dt / FRAME)
    if worn.floating is not None and floating is not None:
        f = worn.floating
        floating.x[f.free] = x[f.vertices[f.free]]
        held = f.free[part[f.vertices[f.free]] < 1]
        floating.v[held] = (floating.x[held] - before[held]) / dt
    return Now(x, skin, met, foot, up, joints, part, limbs, rough, floating)


def _together(f: Floating, state: State, before: Single, dt: float) -> None:
    """No floating vertex jumps alone, as it would where another side of the body becomes the nearest."""
    way = state.x - before
    mean = f.mean @ way
    own = way[f.free] - mean
    size, most = np.linalg.norm(own, axis=1), np.linalg.norm(mean, axis=1) + ALONE
    far = np.flatnonzero(size > most)
    some = f.free[far]
    way[some] = mean[far] + own[far] * (most[far] / size[far])[:, None]
    state.x[some] = before[some] + way[some]
    state.v[some] = way[some] / dt


def simulated(sheet: Sheet, layer: Ints, gap: float, home: NDArray[np.bool_]) -> Floating | None:
    """What floats, with the vertices around it."""
    from scipy.sparse import csr_array

    some = (layer[sheet.triangles] == FLOATING).any(axis=1)
    if not some.any():
        return None
    vertices, triangles = np.unique(sheet.triangles[some], return_inverse=True)
    own = Sheet(triangles.reshape(-1, 3).astype(np.int32), sheet.material[some], sheet.fabric[some], sheet.fabrics)
    held = layer[vertices] != FLOATING
    border, free = np.flatnonzero(held).astype(np.int32), np.flatnonzero(~held).astype(np.int32)
    a, b = np.concatenate([own.edges, own.edges[:, ::-1]]).T
    degree = np.maximum(np.bincount(a, minlength=len(vertices)), 1)
    mean = csr_array(((1 / degree[a]).astype(np.float32), (a, b)), (len(vertices), len(vertices)))[free]
    return Floating(
        vertices.astype(np.int32), assemble(own, pinned=border, gap=gap), border, home[vertices], free, mean
    )  # fmt: skip


def rings(edges: Ints, start: NDArray[np.bool_], most: int = 16) -> Ints:
    """(n,) how many edges each vertex is from those of `start` (n,), `most` at most."""
    out = np.where(start, 0, most).astype(np.int32)
    a, b = edges.T
    for k in range(1, most):
        reached = np.concatenate([b[out[a] == k - 1], a[out[b] == k - 1]])
        new = reached[out[reached] > k]
        if not len(new):
            break
        out[new] = k
    return out
