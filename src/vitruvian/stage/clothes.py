"""Clothes on a stage: each garment is an actor that moves with the one who wears it.

Source: seed 003, sections 5.3.2 and 6.3; note cloth.md, section 7.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats
from vitruvian.cloth.garment import Garment, charted
from vitruvian.cloth.solver import FRAME
from vitruvian.cloth.wear import Prepared, Wearer, entered, wear, wearer
from vitruvian.cloth.worn import Now, begun, moved, shifted
from vitruvian.deform.normals import Incidence, incidence, mesh_normals
from vitruvian.errors import VitruvianError
from vitruvian.stage.actor import Actor
from vitruvian.stage.clip import Mesh

if TYPE_CHECKING:
    from vitruvian.stage.stage import Stage

Single = NDArray[np.float32]
CALMING = 12  # frames in which cloth comes to rest after a leap
MOST = 8  # threads
COLOURS = ((0.33, 0.42, 0.58), (0.62, 0.30, 0.27), (0.80, 0.76, 0.66), (0.30, 0.36, 0.30))


@dataclass(frozen=True, eq=False)
class Cloth:
    """What a garment's actor is drawn with: its normals follow from its points."""

    around: Incidence
    last: list[tuple[Single, Single]] = field(
        default_factory=list
    )  # points and their normals, which are asked for twice

    def normals(self, vertices: Single) -> Single:
        """(n,3) unit normals of points (n,3)."""
        for points, found in tuple(self.last):
            if points is vertices:
                return found
        made = mesh_normals(self.around, vertices[None])[0]
        self.last[:] = [(vertices, made)]
        return made


@dataclass(eq=False)
class Dress:
    """A garment on a stage: what is prepared of it, and where it is now; `matrices` (J,4,4) that this belongs to."""

    actor: Actor
    prepared: Prepared
    cloth: Cloth
    now: Now | None = None
    matrices: Floats | None = None
    round: int = 0  # of the wearer's motion
    shared: dict[str, NDArray] = field(default_factory=dict)  # of it and what is below

    def show(self, stage: Stage) -> None:
        """Its points are those of its actor in this tick."""
        assert self.now is not None
        own = stage.draft(self.actor.name)
        own.vertices, own.cloth, own.of = self.now.x, self.cloth, own.matrices


class Wardrobe:
    """The clothes of a stage's actors, and the system that moves them; see `dressed`."""

    def __init__(self) -> None:
        self.worn: dict[str, tuple[Actor, Wearer, list[Dress]]] = {}
        self.wind: Floats | None = None  # (3,) m/s, humanoid space
        self.pool: ThreadPoolExecutor | None = None

    def __call__(self, stage: Stage, dt: float) -> None:
        # people do not wait for each other: what each wears is computed by itself, the same in any number of threads
        here = [one for one in self.worn.values() if len(stage.draft(one[0].name).matrices)]
        work = deque(self._dress(stage, dt, *one) for one in here)
        most = min(os.cpu_count() or 1, MOST)
        if len(work) > 1 and self.pool is None:
            self.pool = ThreadPoolExecutor(most, "clothes")
        if self.pool is None:
            _worked(work)
        else:
            for _ in self.pool.map(_worked, [work] * min(most, len(work))):
                pass
        for _, _, dresses in here:
            for dress in dresses:
                dress.show(stage)

    def _dress(self, stage: Stage, dt: float, actor: Actor, person: Wearer, dresses: list[Dress]) -> Iterator[None]:
        """Moves what somebody wears, a garment at a time."""
        draft = stage.draft(actor.name)
        points = draft.vertices
        if points is None or len(points) != len(person.skin.points):  # at another level of detail, or left to the page
            points = person.run(draft.matrices)
        if all(d.matrices is draft.matrices for d in dresses) and dt == 0 and not stage.leapt:
            return
        skin, joints = person.on(points), person.joints(draft.matrices)
        met = skin
        for k, dress in enumerate(dresses):
            worn = dress.prepared.worn
            if dress.now is not None and dress.round != actor.round:  # a walk begins again where it began
                dress.now = shifted(dress.now, (dress.round - actor.round) * actor.travel)
            dress.round = actor.round
            if dress.now is None:
                dress.now = entered(dress.prepared, person, draft.matrices)
            if dress.matrices is None or stage.leapt:
                dress.now = begun(worn, skin, joints, met) if stage.leapt else replace(dress.now, met=met)
                for _ in range(CALMING):
                    dress.now = moved(worn, dress.now, skin, joints, below=met)
            else:
                dress.now = moved(worn, dress.now, skin, joints, dt=dt or FRAME, wind=self.wind, below=met)
            dress.matrices = draft.matrices
            if k + 1 < len(dresses):
                x = dress.now.x
                met = met.under(x, dress.cloth.normals(x), dress.prepared.garment.triangles, dress.shared)
            yield


def _worked(work: deque[Iterator[None]]) -> None:
    """Does a piece of the work that is in front, then puts the rest of it behind, until there is nothing left."""
    while True:
        try:
            some = work.popleft()
        except IndexError:
            return
        if next(some, work) is None:
            work.append(some)


def dressed(stage: Stage, name: str, garments: Sequence[Prepared] | Garment) -> Wardrobe:
    """Have an actor of a stage wear a garment that was draped on its body, with those below it, or what
    `vitruvian.cloth.wear.wear` has made of it, innermost first: each becomes an actor called `garment`, or `garment-NAME`
    of several. The stage does not leave out ticks from then on.

    Raises VitruvianError for an actor without joints and garments of another body.
    """
    actor = stage.actors.get(name)
    if actor is None or actor.body is None:
        raise VitruvianError(f"dressed: expected one of the stage's figures, found {name!r}")
    wardrobe = next((s.run for s in stage.systems if isinstance(s.run, Wardrobe)), None)
    if wardrobe is None:
        wardrobe = Wardrobe()
        stage.add(wardrobe, name="cloth", after="deform", every=True)
    run = stage.workshop.bound(actor, body=actor.levels[min(actor.levels)].body)
    if run is None:  # whoever shows the frames runs it, and nobody else has its points
        from vitruvian.deform.deformer import deformer

        run = deformer(actor.deformer, actor.body, **actor.options)
    person = wearer(run)
    prepared = wear(garments, person) if isinstance(garments, Garment) else tuple(garments)
    before = wardrobe.worn.get(name, (actor, person, []))[2]
    dresses = list(before)
    for one in prepared:
        made = one.garment
        uv, corners = charted(made)
        alone = len(prepared) == 1 and "garment" not in stage.actors
        title, n = "garment" if alone else f"garment-{made.name}", 2
        while title in stage.actors:
            title, n = f"garment-{made.name} {n}", n + 1
        color = np.tile(COLOURS[len(dresses) % len(COLOURS)], (len(made.vertices), 1))
        mesh = Mesh(one.x, made.triangles, uv, color, title, uv_triangles=corners)
        thing = Actor(title, mesh=mesh, on=actor)
        stage.enter(thing)
        dresses.append(Dress(thing, one, Cloth(incidence(one.x, made.triangles))))
    wardrobe.worn[name] = (actor, person, dresses)
    stage.step(0)
    return wardrobe
