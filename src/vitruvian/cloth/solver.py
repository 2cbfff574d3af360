"""The cloth solver: one frame after the other, each in many small steps.

Source: note cloth.md, section 4; Macklin et al. (2019), "Small steps in physics simulation". Positions are float32; the
same input gives the same bits: one thread moves the cloth, several may look for what is near to what.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.types import Floats, Ints, floats, indices, require
from vitruvian.cloth.constraints import LEAST, Groups, grouped, hinges, membranes, shapes, stiffened, yielding
from vitruvian.cloth.obstacle import Meets
from vitruvian.cloth.sheet import Sheet
from vitruvian.errors import VitruvianError
from vitruvian.native import kernels

Single = NDArray[np.float32]
FRAME, SUBSTEPS = 1 / 60, 20
GRAVITY = (0.0, -9.81, 0.0)
AIR, DRAG = 1.2, 1.2  # kg/m3, and the drag coefficient of a plate across the wind
SEEK = 10  # frames after which the triangles of the body that are nearest are looked for anew
PLAN = 30  # frames after which it is ordered anew by what is near to what
FIRM = 1.5  # gaps: what was so near is on the side where it was, whatever a frame makes of it
HURRY, SUDDEN = 1.5, 4.9  # what is near may be so much faster in the coming frame, and m/s^2 that set it moving
BENDS, SLOW = (4, 2), 8.0  # hinges are worked off in one of so many steps, if they are so many times softer than a step
CARRY = 0.5  # of the multipliers that the next substep begins with; with more, what one pass leaves to the next rings
GIVE = 0.009  # share by which a cloth that hangs may be longer than its fabric makes it
FARTHEST = 1e4  # metres: of cloth, not of a solution that has burst
NONE: Ints = np.zeros((0, 2), np.int32)


@dataclass(frozen=True, eq=False)
class Cloth:
    """A sheet ready to be moved: its constraints in groups, (n,) inverse masses (0: pinned), and what it keeps from itself.

    gap: metres between parts that touch, 0: they pass through each other. same (n,): vertices with one number are sewn to
    each other, or will be, and do not keep that gap.
    """

    sheet: Sheet
    inverse_mass: Single
    membranes: Groups
    hinges: Groups
    shapes: Groups
    tethers: Groups
    pinned: Ints
    same: Ints
    gap: float = 0.0
    kept: dict[float, tuple[Single, Single, Single, int]] = field(default_factory=dict)  # what `tuned` has worked out

    def tuned(self, h: float) -> tuple[Single, Single, Single, int]:
        """Coefficients of membranes, hinges and shapes for steps of h seconds; what bends is worked off in one of so many
        steps."""
        if h not in self.kept:
            membrane = stiffened(self.membranes, self.yielding * (1 - CARRY) * h * h)
            soft = [(1.0 / y) / (h * h) for y in self.bending]
            slow = float(np.quantile(np.concatenate([v.ravel() for v in soft]), 0.02)) if any(map(len, soft)) else 1.0
            bends = next((m for m in BENDS if slow > SLOW * m), 1)
            rests = []
            for groups, y in zip((self.hinges, self.shapes), self.bending):
                rest = groups.rest.copy()
                rest[:, -1] *= np.maximum(1 - 0.5 * bends * h * h * y, 0.05)
                rests.append(rest)
            self.kept[h] = membrane, rests[0], rests[1], bends
        return self.kept[h]

    @cached_property
    def yielding(self) -> Floats:
        """How much softer one pass a step makes membranes (g,2,8), weft and warp: compliance over h^2."""
        return yielding(self.membranes, self.sheet, self.inverse_mass)

    @cached_property
    def bending(self) -> tuple[Floats, Floats]:
        """The same of hinges and shapes, (g,8) each, over their compliance: 1/s^2."""
        w = np.append(self.inverse_mass, 0.0).astype(np.float64)
        out = []
        for groups, sums, own in ((self.hinges, 1, 4), (self.shapes, 3, 6)):
            factor = groups.rest[:, :-1].astype(np.float64).reshape(-1, sums, own, 8)
            weight = np.mean(np.sum(w[groups.index][:, None] * factor**2, axis=2), axis=1)
            out.append(np.maximum(weight, 1e-30) / groups.rest[:, -1])
        return out[0], out[1]

    @cached_property
    def friction(self) -> tuple[Single, Single]:
        """(n,) of each vertex with the body, and with cloth."""
        of = self.sheet.of_vertices
        return of("friction_body").astype(np.float32), of("friction_self").astype(np.float32)

    def state(self, positions: ArrayLike, velocities: ArrayLike | None = None) -> State:
        """Where it begins: (n,3) metres, and m/s."""
        x = floats(positions, "positions", len(self.inverse_mass), 3)
        v = np.zeros_like(x) if velocities is None else floats(velocities, "velocities", len(x), 3)
        return State(x.astype(np.float32), v.astype(np.float32))


@dataclass(frozen=True, eq=False)
class State:
    """x (n,3) metres and v (n,3) m/s after `frame` frames. nearest (n,): the body's triangle that each vertex was nearest
    to, or none yet; near (c,2) and side (c,): vertices and triangles that were near, and on which side; plan: in what order
    the kernel looks for what is near."""

    x: Single
    v: Single
    frame: int = 0
    nearest: Ints | None = None
    near: Ints = field(default_factory=lambda: NONE)
    side: Single = field(default_factory=lambda: np.zeros(0, np.float32))
    drive: tuple[Single, Single] | None = None
    plan: tuple[Ints, ...] | None = None

    @property
    def speed(self) -> float:
        """Root mean square, m/s."""
        return float(np.sqrt(np.mean(np.sum(self.v.astype(np.float64) ** 2, axis=1)))) if len(self.v) else 0.0


@dataclass(frozen=True, eq=False)
class Pairs:
    """Vertices (p,2) drawn together: metres apart at most at a frame's begin and end, (p,) each; compliance m/N."""

    vertices: Ints
    start: Floats
    end: Floats
    compliance: float = 0.0


def assemble(
    sheet: Sheet,
    *,
    pinned: ArrayLike | None = None,
    gap: float = 0.0,
    same: ArrayLike | None = None,
    bend: str | None = None,
) -> Cloth:
    """Constraints of a sheet; `pinned` (k,) vertices are held, or moved by `targets` of `step`. See `Cloth`.

    bend: "hinge", stiff against folding at each edge, which is quick, or "shape", against the curvature of each triangle,
    which tells weft from warp (note cloth.md, 4.3). None: as the fabrics say.
    """
    require(bend in (None, "hinge", "shape"), "bend", "hinge, shape or None", bend)
    by_shape = bend == "shape" or (bend is None and any(f.bends_by == "shape" for f in sheet.fabrics))
    held = np.zeros(0, np.int32) if pinned is None else indices(pinned, "pinned", sheet.count, None)
    with np.errstate(divide="ignore"):
        inverse = np.where(sheet.masses > 0, 1 / sheet.masses, 0.0)
    inverse[held] = 0.0
    n = sheet.count
    nothing = Groups(np.zeros((0, 2, 8), np.int32), np.zeros((0, 1, 8), np.float32))
    return Cloth(
        sheet,
        inverse.astype(np.float32),
        grouped(*membranes(sheet), n),
        Groups(np.zeros((0, 4, 8), np.int32), np.zeros((0, 5, 8), np.float32))
        if by_shape
        else grouped(*hinges(sheet), n),
        grouped(*shapes(sheet), n)
        if by_shape
        else Groups(np.zeros((0, 6, 8), np.int32), np.zeros((0, 19, 8), np.float32)),
        nothing,
        held,
        np.arange(n, dtype=np.int32) if same is None else indices(same, "same", n, n),
        gap,
    )


def step(
    cloth: Cloth,
    state: State,
    *,
    dt: float = FRAME,
    substeps: int = SUBSTEPS,
    gravity: tuple[float, float, float] = GRAVITY,
    damping: float | None = None,
    targets: ArrayLike | None = None,
    pairs: Pairs | None = None,
    obstacle: Meets | None = None,
    wind: ArrayLike | None = None,
    threads: int = 0,
) -> State:
    """The state after `dt` seconds.

    damping 1/s (None: the fabrics' mean); targets (k,3): where pinned vertices are at the end; pairs: what is sewn
    meanwhile; obstacle: the body in this frame; wind (3,) m/s: the air (None: there is none). Where the cloth has a
    gap its parts do not pass through each other. threads: that look for what touches (0: chosen by size); the result is the
    same for any number.
    """
    require(
        0 < dt <= 0.1 and 1 <= substeps <= 200, "dt, substeps", "up to 0.1 s in 1 to 200 steps", f"{dt:g}, {substeps}"
    )
    n, sheet = len(cloth.inverse_mass), cloth.sheet
    x, v, d = (np.zeros((n + 1, 4), np.float32) for _ in range(3))
    x[:n, :3], x[:n, 3], v[:n, :3] = state.x, cloth.inverse_mass, state.v
    if wind is not None:
        v[:n, :3] += blown(cloth, state, floats(wind, "wind", 3), dt)
    if damping is None:
        damping = float(np.mean([f.damping for f in sheet.fabrics]))
    path = np.zeros((len(cloth.pinned), 6), np.float32)
    path[:, :3] = path[:, 3:] = state.x[cloth.pinned]
    if targets is not None:
        path[:, 3:] = floats(targets, "targets", len(cloth.pinned), 3)
    stretch = np.zeros((len(cloth.membranes.index), 3, 8), np.float32)
    if state.drive is not None:
        d[:n, :3], stretch = state.drive[0], state.drive[1].copy()
    membrane_rest, hinge_rest, shape_rest, bends = cloth.tuned(dt / substeps)
    sewn = np.zeros((0, 3), np.float32) if pairs is None else _rests(pairs)
    nearest = np.full(n, -1, np.int32)
    if obstacle is not None:
        fresh = state.nearest is None or state.frame % SEEK == 0
        nearest = obstacle.nearest(state.x.astype(np.float64))[1] if fresh else state.nearest.copy()  # type: ignore[union-attr]
    touch, known, plan = _touching(cloth, state, x, v, dt, substeps, threads)
    native = kernels()
    if native is None:
        from vitruvian.cloth.solver_numpy import cloth_frame
    else:
        cloth_frame = native.cloth_frame
    empty = (
        np.zeros((0, 3), np.int32),
        np.zeros((0, 3), np.int32),
        np.zeros((0, 6), np.float32),
        np.zeros((0, 6), np.float32),
    )
    body = empty if obstacle is None else (obstacle.triangles, obstacle.neighbours, obstacle.start, obstacle.end)
    limits = (0.0, 0.0, 0.0) if obstacle is None else (obstacle.offset, obstacle.most, obstacle.reach)
    cloth_frame(
        x, v, d, stretch, bends, CARRY,
        cloth.membranes.index, membrane_rest, cloth.hinges.index, hinge_rest,
        cloth.shapes.index, shape_rest,
        cloth.tethers.index, cloth.tethers.rest,
        dt, substeps, np.asarray(gravity, np.float32), damping, 0.5 * cloth.gap,
        cloth.pinned, path,
        np.zeros((0, 2), np.int32) if pairs is None else np.ascontiguousarray(pairs.vertices, np.int32), sewn,
        *body, *limits, nearest, cloth.friction[0],
        *touch,
    )  # fmt: skip
    if not (np.abs(x[:n, :3]) < FARTHEST).all():  # nor is it a number
        raise VitruvianError(
            f"cloth: it burst in frame {state.frame} of {dt / substeps:.2g} s a step; take more substeps, or a softer or "
            "heavier fabric"
        )
    near, side = known
    seen = nearest if obstacle is not None else state.nearest
    return State(
        x[:n, :3].copy(), v[:n, :3].copy(), state.frame + 1, seen, near, side, (d[:n, :3].copy(), stretch), plan
    )


def substeps_for(cloth: Cloth, *, give: float | None = GIVE, dt: float = FRAME) -> int:
    """In how many steps a frame is to be worked off, `SUBSTEPS` at least and 200 at most.

    One pass a step makes cloth softer than its fabric, as fine meshes and long steps do most. give: by which share a cloth
    as long as the root of its area may grow for that reason when it is hung up; None: as many steps as make the cloth as
    stiff as its fabric, where it rests.
    """
    area, m = cloth.sheet.areas, cloth.membranes
    real = m.index[:, 0] < len(cloth.inverse_mass)
    own = cloth.yielding.mean(axis=1)[real] * (1 - CARRY)  # compliance over h^2
    size = 0.5 / np.abs(m.rest[:, 0] * m.rest[:, 3] - m.rest[:, 1] * m.rest[:, 2])[real].astype(np.float64)
    if give is None:
        want = np.quantile(cloth.yielding * (1 - CARRY) / m.rest[:, [4, 6]], 0.98) / (1 - LEAST)
        for quick in cloth.bending:
            if len(quick):
                want = max(want, SLOW * np.quantile(quick, 0.98))
    else:
        weight = 9.81 * cloth.sheet.masses.sum() / np.sqrt(area.sum())  # N/m
        want = weight * float(np.mean(own * size)) / give
    return int(np.clip(np.ceil(dt * np.sqrt(want)), SUBSTEPS, 200))


def blown(cloth: Cloth, state: State, wind: Floats, dt: float) -> Floats:
    """(n,3) m/s that the air gives each vertex in `dt` seconds: its pressure on each triangle, 1/2 rho Cd A times the
    square of the speed along the normal at which they meet. No triangle gets faster than the air by that."""
    t, x, v = cloth.sheet.triangles, state.x.astype(np.float64), state.v.astype(np.float64)
    normal = 0.5 * np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]])
    area = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(area, 1e-30)[:, None]
    meet = np.sum((wind - v[t].mean(axis=1)) * normal, axis=1)
    density = np.array([f.density for f in cloth.sheet.fabrics])[cloth.sheet.fabric]
    push = 0.5 * AIR * DRAG * area * np.abs(meet) * dt  # N s, over meet
    push = np.minimum(push, density * cloth.sheet.areas) * meet
    out = np.zeros_like(x)
    for k in range(3):
        for j in range(3):
            out[:, j] += np.bincount(t[:, k], push * normal[:, j] / 3, len(x))
    return out * cloth.inverse_mass[:, None]


def _rests(pairs: Pairs) -> Single:
    out = np.full((len(pairs.vertices), 3), pairs.compliance, np.float32)
    out[:, 0], out[:, 1] = pairs.start, pairs.end
    return out


def _touching(
    cloth: Cloth, state: State, x: Single, v: Single, dt: float, substeps: int, threads: int
) -> tuple[tuple, tuple[Ints, Single], tuple[Ints, ...] | None]:
    """What of the cloth is near to itself at the frame's begin, as the kernel takes it, and what to remember."""
    nothing = np.zeros(0, np.float32)
    if not cloth.gap:
        return (np.zeros((0, 4), np.int32), nothing, nothing, nothing, 0), (NONE, nothing), None
    native = kernels()
    firm = FIRM * cloth.gap
    limits = np.array([firm + SUDDEN * dt * dt, HURRY * dt, cloth.gap * substeps, firm], np.float32)
    if native is None:
        from vitruvian.cloth.touch_numpy import near_cloth, near_plan
    else:
        near_cloth, near_plan = native.near_cloth, native.near_plan
    n, sheet, plan = len(state.x), cloth.sheet, state.plan
    surface = sheet.triangles, sheet.edges, sheet.sides
    if plan is None or state.frame % PLAN == 0:
        plan = near_plan(x[:n], *surface)
    index, side, key, kept = near_cloth(
        x[:n], v[:n], *surface, cloth.same, limits, state.near, state.side, plan, threads
    )
    gap = np.full(len(index), cloth.gap, np.float32)
    friction = cloth.friction[1][index[:, 0]]
    return (index, side, gap, friction, len(side)), (key, kept), plan
