"""Deformers: a body and joint matrices in, vertices, per-vertex frames and normals out.

Every operator blends the matrices M_i of the joints of a vertex with weights w_i into A, and moves the rest point by A:

- "linear": A = sum w_i M_i; weights that do not sum to one leave the rest in place: p' = p + sum w_i (M_i p - p).
- "dual-quaternion": the normalised sum of w_i times the dual quaternions of M_i.
- "log" (the default of the package): A_0 of "dual-quaternion", then `steps` times A <- A exp(sum w_i log(A^-1 M_i)),
  which converges to the mean of the motions. Turns with the character, does not depend on order, does not collapse.
- "log-pair": M_b exp(sum w_i log(M_b^-1 M_i)), b the joint with the largest weight. Jumps where b changes.
- "log-absolute": exp(sum w_i log M_i), as first published; it changes when the whole character turns.
- "hybrid": "linear" where joints turn little, "log" elsewhere, faded.
- "volume": the rotation of "log", with cross-sections centred on the bent bone; see `volume`.
- "hand": "log", and hands by their links, with knuckles and swelling palms; see `hands`.
- "contours": each contour of the surface moves as one piece by shares of its joints' rotations; see `contours`.

Sources: M. Alexa, "Linear combination of transformations" (2002); L. Kavan et al. (2008); V. Govindu, "Lie-algebraic
averaging for globally consistent motion estimation" (2004).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.hands import Rounding
from vitruvian.body.types import Body, Floats, floats, require
from vitruvian.deform.bind import bind
from vitruvian.deform.contours import ContourOperator
from vitruvian.deform.hand_links import hands_of
from vitruvian.deform.hands import HandOperator
from vitruvian.deform.hybrid import Hybrid, Painted
from vitruvian.deform.morphs import Morphs, add_after, pack_morphs, shift
from vitruvian.deform.motions import chain
from vitruvian.deform.normals import (
    Incidence,
    hanim_normals,
    incidence,
    mesh_normals,
    operator_normals,
    surface_frames,
)
from vitruvian.deform.operators import Linear, Operator, Rigid, apply
from vitruvian.deform.se3 import polar
from vitruvian.deform.volume import Volume, sections
from vitruvian.errors import VitruvianError

Single = NDArray[np.float32]
WEIGHTED = ("linear", "dual-quaternion", "log", "log-pair", "log-absolute", "hybrid", "volume")
NAMES = (*WEIGHTED, "contours", "hand")


def deformer(
    name: str,
    body: Body,
    *,
    weights: str = "as_file",
    steps: int = 1,
    tolerance: float = 0.0005,
    angle: float | None = None,
    fade: bool = True,
    mix: ArrayLike | Mapping[str, ArrayLike] | None = None,
    follow: bool = True,
    live: bool = False,
    off: Collection[str] = (),
    survey: bool = False,
    twist: str = "exact",
    hands: Mapping[str, Rounding] | bool | None = None,
    rounded: bool = True,
    threads: int = 0,
) -> Deformer:
    """Binds an operator to a body.

    `weights`: "as_file" (what is missing to a sum of one stays at rest) or "normalise". `steps` 0..3 of "log".
    `tolerance` (metres), `angle` (radians, replaces it) and `fade` belong to "hybrid".
    `mix` (V,), 0..1, paints between "linear" (0) and the operator (1); {name: (V,)} gives other operators shares of the
    result, which sum to at most one, and the operator what is left.
    `follow`: consecutive frames of one call keep twists continuous past 180 degrees; `live`: of consecutive calls, too,
    so that what a call answers depends on those before it (all operators that blend by weights; `forget` starts anew). A
    Stage does without: it keeps what it knows of a joint with the pose.
    `off`: surfaces of "contours" that follow their joint as rigid pieces; `survey`: its contours keep the volume
    between them; `twist`: "exact", or "paper" for twists estimated as first published.
    `hands`: the hands' own deformation over any operator, which "hand" always has; a mapping gives roundings by joint
    or finger ("index", "l_thumb", "" for all). `rounded` False: without the hands' second pass, that is knuckles, arcs
    and muscle.
    `threads` 0 chooses by size; results never depend on it.
    Raises VitruvianError for a name that is not in `NAMES` and for options out of range.
    """
    if name not in NAMES:
        raise VitruvianError(f"deformer: expected one of {', '.join(NAMES)}, found {name!r}")
    require(0 <= steps <= 3, "steps", "0 to 3", steps)
    require(5e-5 <= tolerance <= 5e-3, "tolerance", "0.00005 to 0.005 metres", tolerance)
    require(angle is None or 0 <= angle <= np.pi, "angle", "0 to pi radians", angle)
    require(twist in ("exact", "paper"), "twist", "'exact' or 'paper'", repr(twist))
    options = {"weights": weights, "steps": steps, "tolerance": tolerance, "angle": angle, "fade": fade}
    options |= {"follow": follow, "live": live, "off": off, "survey": survey, "twist": twist, "threads": threads}
    if name == "hand" or hands not in (None, False):
        chosen = hands if isinstance(hands, Mapping) else None
        found = hands_of(body, chosen)
        require(bool(found), f"deformer {name!r}", "a body with wrists and fingers", "none")

        def under(body: Body) -> Operator:
            beneath = "log" if name == "hand" else name
            return deformer(beneath, body, mix=mix, **options).operator  # type: ignore[arg-type]

        over = HandOperator(under(body), body.skin, found, rounded)
        beneath = under(over.spared(body))
        if isinstance(beneath, ContourOperator):
            beneath = replace(beneath, spared=over.alone)
        return Deformer(name, body, replace(over, beneath=beneath))
    if mix is not None:
        return _painted(name, body, mix, options)
    joints, rest = len(body.skeleton), body.skin.rest
    if name == "linear":
        return Deformer(name, body, Linear(bind(body.skin.weights, joints, rule=weights), rest, threads))
    if name == "contours":
        require(bool(body.contours), "deformer 'contours'", "a body with contours; make one by `contours`", "none")
        known = {s.name for s in body.contours}
        require(known >= set(off), "off", f"surfaces ({', '.join(sorted(known)[:8])}...)", sorted(set(off) - known))
        return Deformer(name, body, ContourOperator(body, frozenset(off), survey, follow, threads, twist == "paper"))
    rows = bind(body.skin.weights, joints, rule=weights, rigid=True)
    if name == "volume":
        center, radius, rows = sections(body, rows)
    memory = np.full((len(chain(rows, body.skeleton)[0]), 4), np.nan) if live and follow else None
    kind = "log" if name in ("hybrid", "volume") else name
    rigid = Rigid(kind, body, rows, steps, follow, threads, memory)
    operator: Operator = rigid
    if name == "hybrid":
        operator = Hybrid(rigid, tolerance, angle, fade)
    elif name == "volume":
        operator = Volume(rigid, center, radius)
    return Deformer(name, body, operator, () if memory is None else (memory,))


def _painted(name: str, body: Body, mix: ArrayLike | Mapping[str, ArrayLike], options: dict[str, object]) -> Deformer:
    """The operator `name` with painted shares of others, or painted over "linear"."""
    count = len(body.skin.rest)
    base, others = (name, mix) if isinstance(mix, Mapping) else ("linear", {name: mix})
    parts: list[tuple[Operator, Floats]] = []
    memories: list[Floats] = []
    total = np.zeros(count)
    for other, values in others.items():
        title = "mix" if base != name else f"mix[{other!r}]"
        paint = np.ascontiguousarray(values, dtype=np.float64)
        require(paint.shape == (count,), title, f"shape ({count},)", paint.shape)
        require(bool(((paint >= 0) & (paint <= 1)).all()), title, "values in 0..1", "others")
        total += paint
        part = deformer(other, body, **options)  # type: ignore[arg-type]
        parts.append((part.operator, paint))
        memories += part.memories
    over = np.flatnonzero(total > 1 + 1e-6)
    require(not over.size, "mix", "shares that sum to at most 1", f"{total[over[:1]]} at vertex {over[:1]}")
    first = deformer(base, body, **options)  # type: ignore[arg-type]
    threads = getattr(first.operator, "threads", 0)
    operator = Painted(first.operator, tuple(parts), threads) if parts else first.operator
    return Deformer(name, body, operator, (*first.memories, *memories))


@dataclass(frozen=True, eq=False)
class Deformer:
    """An operator bound to a body; made by `deformer`."""

    name: str
    body: Body
    operator: Operator
    memories: tuple[Floats, ...] = ()  # relative turns of the frame before, of a `live` deformer

    def forget(self) -> None:
        """The next call follows no frame before it."""
        for memory in self.memories:
            memory[:] = np.nan

    def __call__(
        self, matrices: Floats, morphs: Mapping[str, ArrayLike] | None = None, out: Single | None = None
    ) -> Single:
        """Skinned points (F,V,3) float32 in humanoid space, for joint matrices (F,J,4,4); (V,3) for (J,4,4).

        `morphs`: displacer weights by name, a number or (F,) each; those not named keep the file's weight; what a joint's
        angle drives is added. `out`
        (F,V,3) float32 C-contiguous is filled and returned.
        Raises VitruvianError when shapes do not fit this body, and naming the first joint whose matrix is not finite.
        """
        frames, single = self._frames(matrices)
        out = self._out(out, (len(frames), len(self.body.skin.rest), 3), single)
        target = out[None] if single else out
        if not self.body.skin.morphs:
            require(not morphs, "morphs", "none: this body has no displacers", list(morphs or ()))
            self.operator.points(frames, target)
            return out
        weights = self.morphs.weights(morphs, frames, self.body.skeleton.parents)
        early = None if self.morphs.before is None else shift(self.morphs.before, weights)
        if early is None:
            self.operator.points(frames, target)
        else:
            assert self.morphs.before is not None
            for f in range(len(frames)):
                rest = self.body.skin.rest.copy()
                rest[self.morphs.before.vertices] += early[f]
                self.operator.points(frames[f : f + 1], target[f : f + 1], rest)
        add_after(self.morphs, weights, frames, target)
        return out

    def tuned(self, hands: Mapping[str, Rounding] | None = None, *, rounded: bool | None = None) -> Deformer:
        """The same with other parameters of the hands (all of them: None is the body's own), or without their second
        pass. Nothing is bound anew, so that it can follow a slider.

        Raises VitruvianError for a deformer without hands, and for names that no link has.
        """
        operator = self.operator
        if not isinstance(operator, HandOperator):
            raise VitruvianError(f"tuned: expected a deformer with hands, found {self.name!r}; make it with hands=True")
        found = hands_of(self.body, hands, like=operator.hands)
        made = replace(self, operator=operator.tuned(found, rounded=rounded))
        for kept in ("morphs", "incidence", "rest_normals"):  # what does not depend on the operator
            if kept in self.__dict__:
                made.__dict__[kept] = self.__dict__[kept]
        return made

    def frames(
        self,
        matrices: Floats,
        morphs: Mapping[str, ArrayLike] | None = None,
        *,
        kind: str = "operator",
        out: Single | None = None,
    ) -> Single:
        """A frame for each vertex, (F,V,3,4) float32; (V,3,4) for (J,4,4). `out` is filled and returned.

        `kind` "operator": the blended transform A, which takes the rest position to the vertex as it is without
        displacers. "orthonormal": the rotation nearest to A's 3x3, with the translation that takes the rest position to
        the vertex. "surface": columns tangent, bitangent and normal of the deformed surface, right-handed, and the vertex
        itself: what cloth is laid on. Its tangent is bound to the skin: see `normals.surface_frames`.
        Vertices are those that this deformer answers for `matrices` and `morphs`.
        """
        kinds = ("operator", "orthonormal", "surface")
        require(kind in kinds, "kind", " or ".join(map(repr, kinds)), repr(kind))
        poses, single = self._frames(matrices)
        rest = self.body.skin.rest
        out = self._out(out, (len(poses), len(rest), 3, 4), single)
        target = out[None] if single else out
        self.operator.frames(poses, target)
        if kind == "operator":
            return out
        if self.body.skin.morphs or morphs:
            moved = self(poses, morphs)
        else:
            moved = np.stack([apply(frame, rest) for frame in target.astype(np.float64)])
        if kind == "surface":
            normals = self.normals(moved.astype(np.float32))
            target[:] = surface_frames(target, moved, normals, self.rest_normals)
            return out
        rotation = polar(target[..., :3].astype(np.float64))[0]
        target[..., :3] = rotation
        target[..., 3] = moved - np.einsum("fvab,vb->fva", rotation, rest)
        return out

    def normals(self, vertices: Single) -> Single:
        """Unit normals (F,V,3) of skinned vertices (F,V,3), weighted by area over the welded mesh; (V,3) for (V,3)."""
        points = np.ascontiguousarray(vertices, dtype=np.float32)
        require(points.shape[-2:] == self.body.skin.rest.shape, "vertices", "one row per vertex", points.shape)
        single = points.ndim == 2
        out = mesh_normals(self.incidence, points[None] if single else points, getattr(self.operator, "threads", 0))
        return out[0] if single else out

    def operator_normals(self, matrices: Floats) -> Single:
        """Unit normals (F,V,3) from the transforms alone, ignoring how the weights vary; (V,3) for (J,4,4)."""
        return operator_normals(self.frames(matrices), self.rest_normals).astype(np.float32)

    def hanim_normals(self, matrices: Floats, rest: ArrayLike | None = None) -> Single:
        """Unit normals (F,V,3) as browsers move those of a file; (V,3) for (J,4,4): see `normals.hanim_normals`.

        `rest` (V,3): the file's own, `Humanoid.skin_normal`; None: those of the mesh at rest.
        Raises VitruvianError for shapes that do not fit and for joints scaled to nothing.
        """
        poses, single = self._frames(matrices)
        given = self.rest_normals if rest is None else floats(rest, "rest", *self.body.skin.rest.shape)
        names = self.body.skeleton.names
        out = hanim_normals(bind(self.body.skin.weights, len(names)), poses, given, names).astype(np.float32)
        return out[0] if single else out

    @cached_property
    def morphs(self) -> Morphs:
        """The body's displacers, packed."""
        return pack_morphs(self.body.skin.morphs)

    @cached_property
    def incidence(self) -> Incidence:
        """The welded mesh."""
        return incidence(self.body.skin.rest, self.body.skin.triangles)

    @cached_property
    def rest_normals(self) -> Floats:
        """(V,3) at rest."""
        return mesh_normals(self.incidence, self.body.skin.rest[None].astype(np.float32))[0].astype(np.float64)

    def _frames(self, matrices: Floats) -> tuple[Floats, bool]:
        joints = len(self.body.skeleton)
        m = np.ascontiguousarray(matrices, dtype=np.float64)
        if m.ndim not in (3, 4) or m.shape[-3:] != (joints, 4, 4):
            require(False, "matrices", f"shape (F, {joints}, 4, 4) or ({joints}, 4, 4)", m.shape)
        if not np.vdot(m, m) < np.inf:  # one number tells, in a microsecond
            wrong = np.argwhere(~np.isfinite(m).all(axis=(-2, -1)))
            if len(wrong):
                at, name = wrong[0].tolist(), self.body.skeleton.names[wrong[0, -1]]
                found = m[tuple(at)][~np.isfinite(m[tuple(at)])][0]
                where = f" in frame {at[0]}" if len(at) > 1 else ""
                require(False, f"matrices of joint {name}{where}", "finite numbers", found)
        return (m[None], True) if m.ndim == 3 else (m, False)

    @staticmethod
    def _out(out: Single | None, shape: tuple[int, ...], single: bool) -> Single:
        shape = shape[1:] if single else shape
        if out is None:
            return np.empty(shape, np.float32)
        if out.shape != shape or out.dtype != np.float32 or not out.flags.c_contiguous:
            require(False, "out", f"float32, C-contiguous, shape {shape}", f"{out.dtype} {out.shape}")
        return out
