"""Displacers, packed so that many frames of many weights cost one product.

Source: ISO/IEC 19774-1, Displacer; under a Joint the offsets are added after skinning, turned by the joint's 3x3
matrix, and never multiplied by skin weights, as X_ITE does it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.rotations import from_matrix, inverse, multiply
from vitruvian.body.types import Drive, Floats, Ints, Morph, require
from vitruvian.deform.se3 import polar


@dataclass(frozen=True, eq=False)
class Group:
    """Displacers that share a joint: `which` (d,) of the body's, vertices (n,), offsets (d, n*3)."""

    joint: int
    which: Ints
    vertices: Ints
    offsets: Floats


@dataclass(frozen=True, eq=False)
class Morphs:
    """All displacers of a skin: those added to the rest positions, and those added after skinning, by joint."""

    names: tuple[str, ...]
    rest_weights: Floats
    before: Group | None
    after: tuple[Group, ...]
    drives: tuple[tuple[int, Drive], ...] = ()  # displacer, and what drives it

    def weights(self, given: Mapping[str, ArrayLike] | None, matrices: Floats, parents: Ints | None = None) -> Floats:
        """(F,D) weights: those of the file, replaced where `given` names a displacer (a number or one per frame), plus
        what the angles of joints add for joint matrices (F,J,4,4) and parents (J,).

        Raises VitruvianError for a name that no displacer has, and for a wrong number of frames.
        """
        frames = len(matrices)
        out = np.tile(self.rest_weights, (frames, 1))
        for name, value in (given or {}).items():
            where = [i for i, n in enumerate(self.names) if n == name]
            require(bool(where), "morphs", f"names of displacers ({', '.join(self.names[:8])}...)", repr(name))
            series = np.asarray(value, dtype=np.float64)
            fits = series.ndim == 0 or series.shape == (frames,)
            require(fits, f"morphs[{name!r}]", f"a number or {frames} of them", series.shape)
            out[:, where] = series if series.ndim == 0 else series[:, None]
        for which, drive in self.drives:
            out[:, which] += driven(drive, matrices, int(parents[drive.joint]) if parents is not None else -1)
        return out


def driven(drive: Drive, matrices: Floats, parent: int) -> Floats:
    """(F,) what a joint's angle adds to a weight, for joint matrices (F,J,4,4).

    The angle is the twist of the joint's rotation against its parent about the axis (swing after twist), -pi to pi.
    """
    own = from_matrix(_turned(matrices[:, drive.joint, :3, :3]))
    if parent >= 0:
        own = multiply(inverse(from_matrix(_turned(matrices[:, parent, :3, :3]))), own)
    own = np.where(own[:, 3:] < 0, -own, own)
    angle = 2 * np.arctan2(own[:, :3] @ drive.axis, own[:, 3])
    return np.interp(angle, drive.angles, drive.weights)


def _turned(linear: Floats) -> Floats:
    """The rotations in 3x3 parts (F,3,3), which may be scaled."""
    gram = np.einsum("fba,fbc->fac", linear, linear)
    return linear if np.abs(gram - np.eye(3)).max(initial=0) < 1e-5 else polar(linear)[0]


def pack_morphs(morphs: tuple[Morph, ...]) -> Morphs:
    """The tables of a skin's displacers."""
    early = [i for i, m in enumerate(morphs) if m.before]
    late: dict[int, list[int]] = {}
    for i, m in enumerate(morphs):
        if not m.before:
            late.setdefault(m.joint, []).append(i)
    return Morphs(
        names=tuple(m.name for m in morphs),
        rest_weights=np.array([m.weight for m in morphs], dtype=np.float64),
        before=_group(morphs, early, -1) if early else None,
        after=tuple(_group(morphs, which, joint) for joint, which in late.items()),
        drives=tuple((i, m.drive) for i, m in enumerate(morphs) if m.drive is not None),
    )


def _group(morphs: tuple[Morph, ...], which: list[int], joint: int) -> Group:
    vertices = np.unique(np.concatenate([morphs[i].index for i in which])).astype(np.int32)
    offsets = np.zeros((len(which), len(vertices), 3))
    for row, i in enumerate(which):
        np.add.at(offsets[row], np.searchsorted(vertices, morphs[i].index), morphs[i].offset)
    return Group(joint, np.array(which, dtype=np.int32), vertices, offsets.reshape(len(which), -1))


def shift(group: Group, weights: Floats) -> Floats | None:
    """(F,n,3): the group's offsets under weights (F,D), None when all are zero."""
    own = weights[:, group.which]
    active = np.flatnonzero(own.any(axis=0))
    if not len(active):
        return None
    return (own[:, active] @ group.offsets[active]).reshape(len(weights), -1, 3)


def add_after(morphs: Morphs, weights: Floats, matrices: Floats, out: NDArray[np.float32]) -> None:
    """Adds the displacers under joints to skinned points `out` (F,V,3), for joint matrices (F,J,4,4)."""
    for group in morphs.after:
        moved = shift(group, weights)
        if moved is not None:
            turned = np.einsum("fab,fnb->fna", matrices[:, group.joint, :3, :3], moved)
            out[:, group.vertices] += turned.astype(np.float32)
