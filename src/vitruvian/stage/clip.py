"""What is shown or exported: a Clip (a moving body) or a Mesh."""

from __future__ import annotations

from dataclasses import dataclass

from vitruvian.body.types import Body, Floats, Ints, floats, indices, require
from vitruvian.cloth.garment import Garment
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.motion.types import Motion
from vitruvian.stage.vertex_cache import VertexCache


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface without skeleton: vertices (V,3) in `unit`, triangles (T,3), uv and colors (V,3) sRGB, or None.

    uv is (V,2), or (U,2) with its own uv_triangles (T,3) where the texture has seams.
    """

    vertices: Floats
    triangles: Ints
    uv: Floats | None = None
    colors: Floats | None = None
    name: str = "object"
    unit: str = "m"
    uv_triangles: Ints | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", floats(self.vertices, "vertices", None, 3))
        object.__setattr__(self, "triangles", indices(self.triangles, "triangles", len(self.vertices), None, 3))
        if self.uv is not None:
            count = len(self.vertices) if self.uv_triangles is None else None
            object.__setattr__(self, "uv", floats(self.uv, "uv", count, 2))
        if self.uv_triangles is not None:
            coordinates = 0 if self.uv is None else len(self.uv)
            seams = indices(self.uv_triangles, "uv_triangles", coordinates, len(self.triangles), 3)
            object.__setattr__(self, "uv_triangles", seams)
        if self.colors is not None:
            object.__setattr__(self, "colors", floats(self.colors, "colors", len(self.vertices), 3))


@dataclass(frozen=True, eq=False)
class Clip:
    """One body with one motion on its own skeleton, drawn with one deformer.

    `humanoid` is the editable form the body was packed from: writers of H-Anim files want its names, Sites and the
    nodes they do not understand. `motion` None means the file's own pose. garment: what it wears, over what is `below`
    that; it moves in real time on a Stage. caches: what it wears as that was computed ahead, for files, see
    `vitruvian.stage.baking`.
    """

    humanoid: Humanoid
    body: Body
    motion: Motion | None = None
    deformer: str = "log"
    garment: Garment | None = None
    caches: tuple[VertexCache, ...] = ()

    def __post_init__(self) -> None:
        if self.garment is not None:
            joints = len(self.body.skeleton)
            found = f"one of {len(self.garment.matrices)} joints"
            require(
                len(self.garment.matrices) == joints, "garment", f"one draped on this body of {joints} joints", found
            )
        if self.motion is not None:
            same = self.motion.skeleton.names == self.body.skeleton.names
            require(same, "motion", "a motion on this body's skeleton", "another skeleton; retarget it first")
