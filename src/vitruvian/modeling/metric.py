"""Figures in inches or hands, which their Humanoid's own scale shrinks to a person, in metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.errors import warn
from vitruvian.hanim.humanoid import Displacer, Humanoid, Shape, Site


def unit_of(humanoid: Humanoid) -> float:
    """Metres in one unit of the figure's own space, by the mean of the Humanoid's scale; 1 where it has none."""
    size = abs(float(np.prod(humanoid.scale))) ** (1 / 3)
    return size if size > 0 and np.isfinite(size) else 1.0


def in_metres(humanoid: Humanoid) -> Humanoid:
    """A copy whose points, centres, Sites and Displacers are in metres, and whose own scale is 1.

    Where it had another, clips, stored poses and bindings are left out, with a warning: they are told in the old unit.
    """
    f = unit_of(humanoid)
    if abs(f - 1) < 1e-9:
        return humanoid
    out = humanoid.copied()
    points: dict[int, Floats] = {}

    def enlarged(array: Floats | None) -> Floats | None:
        """Shapes that shared points share them again."""
        return None if array is None else points.setdefault(id(array), array * f)

    def shape(s: Shape) -> Shape:
        matrix = None if s.transform is None else s.transform.copy()
        if matrix is not None:
            matrix[:3, 3] *= f
        return s if s.points is None else replace(s, points=enlarged(s.points), transform=matrix, node=None)

    def site(s: Site) -> Site:
        shapes = [shape(g) for g in s.shapes]
        return replace(s, translation=s.translation * f, center=s.center * f, shapes=shapes, node=None)

    def displacer(d: Displacer) -> Displacer:
        return replace(d, displacements=d.displacements * f, node=None)

    for joint in {id(j): j for j in out.joints()}.values():
        joint.center, joint.translation = joint.center * f, joint.translation * f
        joint.sites, joint.displacers = [site(s) for s in joint.sites], [displacer(d) for d in joint.displacers]
        for segment in joint.segments:
            segment.coord = enlarged(segment.coord)
            segment.center_of_mass = segment.center_of_mass * f
            segment.moments_of_inertia = segment.moments_of_inertia * f**2
            segment.shapes, segment.sites = [shape(s) for s in segment.shapes], [site(s) for s in segment.sites]
            segment.displacers = [displacer(d) for d in segment.displacers]
            segment.contours = [replace(c, points=c.points * f, node=None) for c in segment.contours]
    out.sites, out.skin = [site(s) for s in out.sites], [shape(s) for s in out.skin]
    out.viewpoints = [site(s) for s in out.viewpoints]
    out.skin_displacers = [displacer(d) for d in out.skin_displacers]
    if out.motions or out.tracks or out.poses or out.binding:
        warn(f"{humanoid.name}: brought to metres; its clips, stored poses and bindings are left out")
    return replace(
        out, skin_coord=out.skin_coord * f, scale=np.ones(3), scale_orientation=np.array([0.0, 0.0, 1.0, 0.0]),
        center=out.center * f, motions=[], motions_enabled=[], tracks=[], poses=[], binding={},
        skin_binding_coords=None, skin_binding_normals=None, made_from=None,
    )  # fmt: skip
