"""The joints and Sites of a figure as glTF nodes, with what glTF has no place for in their extras.

Extras of ours are `{"hanim": {"node": kind, ...}}`: Humanoid, Joint, Site, Viewpoint, Frame (helps the node above it to
stand skew) and Static (never moves). `gltf_rig` and `gltf_reader` read them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vitruvian.body.rotations import from_axis_angle, from_matrix, to_axis_angle, to_matrix
from vitruvian.body.types import Body, Floats, Skeleton
from vitruvian.formats.gltf_buffer import Document

if TYPE_CHECKING:
    from vitruvian.hanim.humanoid import Humanoid, Joint, Segment, Site


class Nodes:
    """The joints as nodes. Attributes: `root` the humanoid's node, `joint` (J,) nodes that are animated, `bone` (J,)
    nodes the skin follows (the same unless a joint has a helper node), `static` a node that never moves. `scale` (F,J,3)
    are the scales that an animation will give the joints."""

    def __init__(self, doc: Document, body: Body, humanoid: Humanoid | None, scale: Floats | None = None):
        self.doc, self.skeleton = doc, body.skeleton
        s = body.skeleton
        self.helpers: list[str] = []
        self.spin = np.tile([0.0, 0, 0, 1], (len(s), 1))  # multiplied on the right of every animated rotation
        tree = _tree(body, humanoid)
        self.root, inner = self._placement(body, humanoid)
        self.inner = inner
        self.joint: list[int] = []
        self.bone: list[int] = []
        turn = to_matrix(s.scale_orientation)
        rotation = to_matrix(s.rotation)
        local = s.translation + s.centers - np.where(s.parents[:, None] >= 0, s.centers[s.parents], 0)
        for j, name in enumerate(s.names):
            node: dict[str, Any] = {"name": name or f"joint_{j}"}
            stretch = s.scale[j]
            matrix = rotation[j]
            sizes = stretch[None] if scale is None else np.concatenate([stretch[None], scale[:, j]])
            plain = all(_along_axes(size, turn[j]) for size in np.unique(sizes, axis=0))
            if not plain:
                self.spin[j] = s.scale_orientation[j]
                matrix = matrix @ turn[j]
            set_trs(node, local[j], from_matrix(matrix), stretch)
            node["extras"] = {"hanim": _extras(s, j, tree[j] if tree else None)}
            index = doc.append("nodes", node)
            self.joint.append(index)
            if not plain:
                self.helpers.append(name)
                back = from_matrix(turn[j].T)
                helper = doc.append("nodes", {
                    "name": f"{name}_frame", "rotation": [float(x) for x in back], "extras": _kind("Frame"),
                })  # fmt: skip
                node["children"] = [helper]
                index = helper
            self.bone.append(index)
            parent = inner if s.parents[j] < 0 else self.bone[s.parents[j]]
            self._hang(parent, self.joint[j])
        if humanoid is not None and tree:
            self._sites(humanoid, tree)
        else:
            for name, j, point in zip(s.site_names, s.site_joints, s.site_points):
                node = {"name": name or "site", "extras": _kind("Site")}
                set_trs(node, point - s.centers[j], np.array([0, 0, 0, 1.0]), np.ones(3))
                self._hang(self.bone[j], doc.append("nodes", node))
        self._static: int | None = None

    def _hang(self, parent: int, child: int) -> None:
        self.doc.root["nodes"][parent].setdefault("children", []).append(child)

    @property
    def static(self) -> int:
        if self._static is None:
            self._static = self.doc.append("nodes", {"name": "static", "extras": _kind("Static")})
            self._hang(self.inner, self._static)
        return self._static

    def _sites(self, humanoid: Humanoid, tree: list[Joint]) -> None:
        """Sites with their frames, under their joints; those of the skeleton field and viewpoints under the humanoid."""
        for sites, kind in ((humanoid.sites, "Site"), (humanoid.viewpoints, "Viewpoint")):
            for site in sites:
                self._hang(self.inner, self._site(site, np.zeros(3), {"node": kind}))
        for joint, bone in zip(tree, self.bone):
            for site in joint.sites:
                self._hang(bone, self._site(site, joint.center, {"node": "Site"}))
            for segment in joint.segments:
                for site in segment.sites:
                    self._hang(bone, self._site(site, joint.center, {"node": "Site", "segment": segment.name}))

    def _site(self, site: Site, center: Floats, extras: dict[str, Any]) -> int:
        node: dict[str, Any] = {"name": site.name or "site", "extras": {"hanim": extras}}
        if np.any(site.translation):
            extras["translation"] = [float(x) for x in site.translation]
        if site.scale_orientation[3] and np.ptp(site.scale):
            extras["scaleOrientation"] = [float(x) for x in site.scale_orientation]
        set_trs(node, site.center + site.translation - center, from_axis_angle(site.rotation), np.asarray(site.scale))
        return self.doc.append("nodes", node)

    def _placement(self, body: Body, humanoid: Humanoid | None) -> tuple[int, int]:
        """The Humanoid's own transform: one node, or two when it shears (placement = T U S, then V^T)."""
        extras: dict[str, Any] = {"node": "Humanoid"}
        if humanoid is not None:
            extras.update(version=humanoid.version, loa=int(humanoid.loa))
            if humanoid.info:
                extras["info"] = dict(humanoid.info)
            if humanoid.skeletal_configuration != "BASIC":
                extras["skeletalConfiguration"] = humanoid.skeletal_configuration
        node: dict[str, Any] = {"name": body.name or "humanoid", "extras": {"hanim": extras}}
        linear = body.placement[:3, :3]
        length = np.linalg.norm(linear, axis=0)
        index = self.doc.append("nodes", node)
        unit = linear / np.where(length > 0, length, 1)
        if np.linalg.det(linear) > 0 and np.allclose(unit.T @ unit, np.eye(3), atol=1e-9):
            set_trs(node, body.placement[:3, 3], from_matrix(unit), length)
            return index, index
        u, stretch, vt = np.linalg.svd(linear)
        if np.linalg.det(u) < 0:
            u[:, 2], stretch[2] = -u[:, 2], -stretch[2]
        if np.linalg.det(vt) < 0:
            vt[2], stretch[2] = -vt[2], -stretch[2]
        set_trs(node, body.placement[:3, 3], from_matrix(u), stretch)
        inner = {"name": f"{node['name']}_frame", "extras": _kind("Frame")}
        set_trs(inner, np.zeros(3), from_matrix(vt), np.ones(3))
        second = self.doc.append("nodes", inner)
        node["children"] = [second]
        return index, second


def _along_axes(size: Floats, turn: Floats) -> bool:
    """Whether a scale (3,) along a turned frame is the same along the axes themselves."""
    even = np.ptp(size) < 1e-9 * np.abs(size).max()
    return bool(even or np.allclose(turn @ np.diag(size) @ turn.T, np.diag(size), atol=1e-12))


def set_trs(node: dict[str, Any], translation: Floats, rotation: Floats, scale: Floats) -> None:
    """TRS of a node; what is the default stays out."""
    if np.abs(translation).max() > 0:
        node["translation"] = [float(np.float32(x)) for x in translation]
    q = np.asarray(rotation, np.float64) / np.linalg.norm(rotation)
    if abs(q[3]) < 1 - 1e-15:
        node["rotation"] = [float(x) for x in q]
    if np.abs(scale - 1).max() > 0:
        node["scale"] = [float(x) for x in scale]


def _kind(node: str) -> dict[str, Any]:
    return {"hanim": {"node": node}}


def _tree(body: Body, humanoid: Humanoid | None) -> list[Joint]:
    """The joints that a body was packed from, in its order; [] when the humanoid is not that one."""
    joints = list({id(j): j for j in humanoid.joints()}.values()) if humanoid is not None else []
    return joints if tuple(j.name for j in joints) == body.skeleton.names else []


def _extras(s: Skeleton, j: int, joint: Joint | None) -> dict[str, Any]:
    """What a joint is beside its transform: centre, limits, stiffness, binding, its Segments with their masses."""
    out: dict[str, Any] = {"node": "Joint", "center": [float(x) for x in s.centers[j]]}
    limit = s.limits[j]
    if joint is not None:
        out |= {k: [float(x) for x in v] for k, v in (("llimit", joint.llimit), ("ulimit", joint.ulimit)) if len(v)}
    elif np.isfinite(limit).all():
        out["llimit"], out["ulimit"] = [float(x) for x in limit[:, 0]], [float(x) for x in limit[:, 1]]
    if abs(s.limit_orientation[j, 3]) < 1 - 1e-12:
        out["limitOrientation"] = [float(x) for x in s.limit_orientation[j]]
    if s.stiffness[j].any():
        out["stiffness"] = [float(x) for x in s.stiffness[j]]
    if s.binding is not None and not np.allclose(s.binding[j], np.eye(4), rtol=0, atol=1e-12):
        linear = s.binding[j, :3, :3]
        size = np.linalg.norm(linear, axis=0)
        turn = to_axis_angle(from_matrix(linear / np.where(size > 0, size, 1)))
        out["binding"] = [float(x) for x in (*s.binding[j, :3, 3], *turn, *size)]
    segments = [_segment(g) for g in joint.segments] if joint is not None else []
    return {**out, "segments": segments} if segments else out


def _segment(segment: Segment) -> dict[str, Any]:
    item: dict[str, Any] = {"name": segment.name}
    if segment.mass:
        item.update(mass=float(segment.mass), centerOfMass=[float(x) for x in segment.center_of_mass])
        if np.any(segment.moments_of_inertia):
            item["momentsOfInertia"] = [float(x) for x in np.ravel(segment.moments_of_inertia)]
    return item
