"""A garment prepared for a body: sorted into layers, and bound to the skin that a deformer moves.

Source: seed 003, sections 5.2 and 5.3.1; note cloth.md, section 6.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.rotations import from_vector
from vitruvian.body.types import Body, Floats, Ints, Skeleton
from vitruvian.cloth.binding import bind
from vitruvian.cloth.garment import Garment
from vitruvian.cloth.layers import Anatomy, anatomy, sort
from vitruvian.cloth.moving import Skin
from vitruvian.cloth.placing import largest
from vitruvian.cloth.worn import Now, Worn, begun, made, moved
from vitruvian.deform.deformer import Deformer

FORK = ("l_hip", "r_hip")
ENTRY = 40  # frames from the pose that a garment was draped in to the first that is shown
# Poses in which it is seen what cloth stays with: joints and their rotation vectors, radians; l_ stands for both sides,
# mirrored, and what is named by its side is for that side alone
TRAINING: tuple[Mapping[str, tuple[float, float, float]], ...] = (
    {"*_shoulder": (0, 0, -0.1)},
    {"*_shoulder": (-1.3, 0, 0), "*_elbow": (-0.5, 0, 0)},
    {"*_shoulder": (0.5, 0, 0.1), "*_elbow": (-1.4, 0, 0)},
    {"*_shoulder": (0, 0, 1.3)},
    {"l_hip": (-0.6, 0, 0), "r_hip": (0.4, 0, 0), "r_knee": (0.5, 0, 0), "l_shoulder": (0.4, 0, 0.1), "r_shoulder": (-0.4, 0, -0.1)},
    {"r_hip": (-0.6, 0, 0), "l_hip": (0.4, 0, 0), "l_knee": (0.5, 0, 0), "r_shoulder": (0.4, 0, -0.1), "l_shoulder": (-0.4, 0, 0.1)},
    {"*_hip": (-1.3, 0, 0.1), "*_knee": (1.3, 0, 0)},
    {"*_hip": (0, 0, 0.5)},
    {"vl3": (0.3, 0, 0), "vt10": (0.3, 0, 0), "*_shoulder": (-0.4, 0, 0.2)},
    {"vl3": (0, 0.3, 0), "vt10": (0, 0.3, 0), "*_shoulder": (0, 0, 0.2)},
    {"vl3": (0, 0, 0.25), "vt10": (0, 0, 0.2), "*_shoulder": (0, 0, 0.2)},
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Wearer:
    """A body that a deformer moves, with the largest piece of its skin, triangles (t,3), and the regions (V,) of that."""

    run: Deformer
    skin: Skin
    known: Anatomy
    regions: Ints

    def at(self, matrices: Floats) -> tuple[Skin, Floats]:
        """The skin under joint matrices (J,4,4), and where the joints are, (J,3) metres."""
        points = self.run(matrices)
        return self.on(points, self.run.normals(points)), places(self.run.body.skeleton, matrices)

    def on(self, points: NDArray[np.float32], normals: NDArray[np.float32]) -> Skin:
        return self.skin.at(points, normals)


def wearer(run: Deformer) -> Wearer:
    """What a body has to do with clothes."""
    body, known = run.body, anatomy(run.body.skeleton)
    rest = body.skin.rest.astype(np.float32)
    triangles = largest(body.skin.triangles, len(rest))
    return Wearer(run, Skin(rest, run.rest_normals.astype(np.float32), triangles), known, known.of(body))


def places(skeleton: Skeleton, matrices: Floats) -> Floats:
    """(J,3) metres: where the joints are under their matrices (J,4,4)."""
    return np.einsum("jab,jb->ja", matrices[:, :3, :3], skeleton.centers) + matrices[:, :3, 3]


def wear(
    garment: Garment,
    person: Wearer,
    *,
    edges: Mapping[str, tuple[float, float]] | None = None,
    painted: Mapping[int, int] | None = None,
    gap: float = 0.0,
) -> Worn:
    """A garment ready to be worn in real time by the person that it was draped on.

    edges: region (see `vitruvian.cloth.layers.REGIONS`) -> metres from the skin up to which cloth is tight, and loose;
    painted: vertex -> layer, what a person decided; gap: metres that floating cloth keeps from itself, 0: passes through.
    """
    skin, joints = person.at(garment.matrices)
    x, triangles = garment.vertices, garment.triangles
    binding = bind(skin.points.astype(np.float64), skin.triangles, x, triangles, skin.normals.astype(np.float64))
    trained = []
    for matrices in training(person.run.body.skeleton):
        there, _ = person.at(matrices)
        points, normals = there.points.astype(np.float64), there.normals.astype(np.float64)
        trained.append((points, binding.at(points, normals)))
    index = person.run.body.skeleton.index
    hips = [joints[index[j], 1] for j in FORK if j in index]
    layer = sort(
        binding, x, triangles, person.regions, person.known, trained, edges=edges,
        crotch=_crotch(skin, person, hips), painted=painted,
    )  # fmt: skip
    regions = person.regions[binding.triangles[binding.face, binding.share.argmax(axis=1)]]
    return made(garment.sheet, x, binding, layer, regions, person.known.bones, skin, joints, gap=gap)


def entered(worn: Worn, person: Wearer, garment: Garment, matrices: Floats, *, frames: int = ENTRY, **options: object) -> Now:
    """The garment at rest on a body under joint matrices (J,4,4), led there from the pose that it was draped in."""
    from vitruvian.body.rotations import from_matrix, slerp

    skin, joints = person.at(garment.matrices)
    now = begun(worn, skin, joints)
    first, last = garment.matrices, matrices
    for k in range(1, frames + 1):
        share = min(1.0, k / (0.75 * frames))
        skin, joints = person.at(blended(person.run.body.skeleton, first, last, share * share * (3 - 2 * share)))
        now = moved(worn, now, skin, joints)
    return now


def training(skeleton: Skeleton) -> list[Floats]:
    """(J,4,4) matrices of each training pose, as far as a skeleton has the joints."""
    out = []
    for pose in TRAINING:
        rotation = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(skeleton), 1))
        for name, (x, y, z) in pose.items():
            for side, sign in (("l", 1.0), ("r", -1.0)) if name.startswith("*") else (("", 1.0),):
                joint = skeleton.index.get(side + name.removeprefix("*"))
                if joint is not None:
                    rotation[0, joint] = from_vector(np.array([x, sign * y, sign * z]))
        out.append(pose_matrices(skeleton, rotation, np.zeros((1, len(skeleton), 3)))[0])
    return out


def _crotch(skin: Skin, person: Wearer, hips: list[float]) -> float | None:
    """Height where the legs part: the lowest of the trunk between them."""
    if not hips:
        return None
    trunk = person.regions == 0
    used = np.zeros(len(trunk), bool)
    used[skin.triangles.ravel()] = True
    return float(skin.points[trunk & used, 1].min())
