"""Clothes on a stage: each garment is an actor that moves with the one who wears it.

Source: seed 003, sections 5.3.2 and 6.3; note cloth.md, section 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats
from vitruvian.cloth.garment import Garment, charted
from vitruvian.cloth.solver import FRAME
from vitruvian.cloth.wear import Prepared, Wearer, entered, wear, wearer
from vitruvian.cloth.worn import Now, begun, moved
from vitruvian.deform.normals import Incidence, incidence, mesh_normals
from vitruvian.errors import VitruvianError
from vitruvian.stage.actor import Actor
from vitruvian.stage.clip import Mesh

if TYPE_CHECKING:
    from vitruvian.stage.stage import Stage

Single = NDArray[np.float32]
CALMING = 12  # frames in which cloth comes to rest after a leap
COLOURS = ((0.33, 0.42, 0.58), (0.62, 0.30, 0.27), (0.80, 0.76, 0.66), (0.30, 0.36, 0.30))


@dataclass(frozen=True, eq=False)
class Cloth:
    """What a garment's actor is drawn with: its normals follow from its points."""

    around: Incidence

    def normals(self, vertices: Single) -> Single:
        """(n,3) unit normals of points (n,3)."""
        return mesh_normals(self.around, vertices[None])[0]


@dataclass(eq=False)
class Dress:
    """A garment on a stage: what is prepared of it, and where it is now; `matrices` (J,4,4) that this belongs to."""

    actor: Actor
    prepared: Prepared
    cloth: Cloth
    now: Now | None = None
    matrices: Floats | None = None


class Wardrobe:
    """The clothes of a stage's actors, and the system that moves them; see `dressed`."""

    def __init__(self) -> None:
        self.worn: dict[str, tuple[Actor, Wearer, list[Dress]]] = {}
        self.wind: Floats | None = None  # (3,) m/s, humanoid space

    def __call__(self, stage: Stage, dt: float) -> None:
        for actor, person, dresses in self.worn.values():
            draft = stage.draft(actor.name)
            if not len(draft.matrices):
                continue
            points = draft.vertices
            if points is None or len(points) != len(person.skin.points):  # at another level of detail, or left to the page
                points = person.run(draft.matrices)
            skin = joints = None
            for dress in dresses:
                same = dress.matrices is draft.matrices
                if dress.now is None or not same or dt > 0 or stage.leapt:
                    if skin is None:
                        skin, joints = person.on(points), person.joints(draft.matrices)
                    if dress.now is None or stage.leapt:
                        worn = dress.prepared
                        dress.now = entered(worn, person, draft.matrices) if dress.now is None else begun(worn.worn, skin, joints)
                        for _ in range(CALMING):
                            dress.now = moved(worn.worn, dress.now, skin, joints)
                    else:
                        dress.now = moved(dress.prepared.worn, dress.now, skin, joints, dt=dt or FRAME, wind=self.wind)
                    dress.matrices = draft.matrices
                own = stage.draft(dress.actor.name)
                own.vertices, own.run, own.of = dress.now.x, dress.cloth, own.matrices


def dressed(stage: Stage, name: str, garments: Sequence[Garment | Prepared]) -> Wardrobe:
    """Have an actor of a stage wear garments that were draped on its body: each becomes an actor called `garment`, or
    `garment-NAME` of several. The stage does not leave out ticks from then on.

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
    dresses = []
    for garment in garments:
        prepared = garment if isinstance(garment, Prepared) else wear(garment, person)
        made = prepared.garment
        uv, corners = charted(made)
        title = "garment" if len(garments) == 1 and "garment" not in stage.actors else f"garment-{made.name}"
        color = np.tile(COLOURS[len(dresses) % len(COLOURS)], (len(made.vertices), 1))
        mesh = Mesh(prepared.x, made.triangles, uv, color, title, uv_triangles=corners)
        thing = Actor(title, mesh=mesh, on=actor)
        stage.enter(thing)
        dresses.append(Dress(thing, prepared, Cloth(incidence(prepared.x, made.triangles))))
    before = wardrobe.worn.get(name, (actor, person, []))[2]
    wardrobe.worn[name] = (actor, person, [*before, *dresses])
    stage.step(0)
    return wardrobe
