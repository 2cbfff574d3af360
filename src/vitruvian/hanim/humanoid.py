"""The H-Anim objects: an editable tree with every field that the standard names.

Metres, radians, Y up, facing +Z, +X to the figure's left. `center` and displacements are in humanoid space.
Rotations here are the standard's axis-angle `x y z angle`; quaternions begin at `vitruvian.body`.
Names of attributes follow Python's case: `skinCoordIndex` is `skin_coord_index`.
Source: ISO/IEC 19774 parts 1 and 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim.graph import Node, Scene

Array = NDArray[np.float64]


def _vec(*values: float) -> Array:
    return np.array(values, dtype=np.float64)


def _floats() -> Array:
    return np.zeros(0)


@dataclass(slots=True, eq=False, kw_only=True)
class Described:
    """What every object may carry (X3D 4.0): words, a Metadata node, and fields beyond the standard's.

    `extras` maps field names to typed values (or source text where nothing tells the type): a robot's `jointAxis`, the
    transform that some files give Segments.
    """

    description: str = ""
    metadata: Node | None = None
    extras: dict[str, object] = field(default_factory=dict)


@dataclass(slots=True, eq=False, kw_only=True)
class Bounded(Described):
    """What objects with an extent may carry. A `bbox_size` below zero means "not given"."""

    bbox_center: Array = field(default_factory=lambda: _vec(0, 0, 0))
    bbox_size: Array = field(default_factory=lambda: _vec(-1, -1, -1))
    bbox_display: bool = False
    visible: bool = True


@dataclass(slots=True, eq=False)
class Displacer(Described):
    """Moves vertices `coord_index` (n,) by `weight * displacements` (n,3).

    Under a Joint the indices are into the humanoid's `skin_coord`, under a Segment into the segment's points.
    """

    name: str
    coord_index: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    displacements: Array = field(default_factory=lambda: np.zeros((0, 3)))
    weight: float = 0.0
    node: Node | None = None

    @property
    def marks(self) -> bool:
        """Whether it marks a region and moves nothing: a `_feature` whose displacements are all zero."""
        return self.name.endswith("_feature") and not self.displacements.any()


@dataclass(slots=True, frozen=True)
class Picture:
    """A picture that texture coordinates lay on a surface: PNG or JPEG `data`, or the `urls` of a file in `folder`.

    `repeat`: whether it repeats beyond 0..1 in u and v. `alpha`: its transparency cuts holes ("mask"), fades ("blend"),
    or does not count ("").
    """

    name: str = ""
    data: bytes = b""
    urls: tuple[str, ...] = ()
    folder: str = ""
    repeat: tuple[bool, bool] = (True, True)
    alpha: str = ""


@dataclass(slots=True, eq=False)
class Material:
    """How a surface looks: sRGB colours in 0..1. `roughness`, `metallic` as in glTF; `emission` sRGB. `ambient`,
    `specular`: ambientIntensity and specularColor of X3D and VRML, None where no file says them.

    `picture` replaces or, where programs do so, multiplies the colour.
    """

    name: str = ""
    color: tuple[float, float, float] = (0.8, 0.8, 0.8)
    roughness: float = 0.6
    metallic: float = 0.0
    opacity: float = 1.0
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    double_sided: bool = False
    node: Node | None = None  # the file's Appearance
    picture: Picture | None = None
    ambient: float | None = None
    specular: tuple[float, float, float] | None = None


@dataclass(slots=True, eq=False)
class Shape:
    """A triangulated surface.

    `points` (n,3), or None when the triangles index the humanoid's `skin_coord`. `triangles` (t,3) int32.
    `uv` (u,2) with `uv_triangles` (t,3), or None. `colors` (n,3) sRGB per point replace the material's, or None.
    `transform` (4,4) places segment geometry in its segment when the file wraps it in Transforms.
    `normals` (m,3) unit, one per point, or per corner by `normal_triangles` (t,3); None: as the faces give them.
    `faces` (t,) numbers the polygon that each triangle was cut from, None when all were triangles.
    `skin_index` (n,): of which skin point each point is a copy, when the shape was cut out of the humanoid's skin.
    """

    name: str = ""
    triangles: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    points: Array | None = None
    uv: Array | None = None
    uv_triangles: NDArray[np.int32] | None = None
    colors: Array | None = None
    material: Material = field(default_factory=Material)
    transform: Array | None = None
    crease_angle: float = np.pi
    node: Node | None = None
    normals: Array | None = None
    normal_triangles: NDArray[np.int32] | None = None
    skin_index: NDArray[np.int32] | None = None
    faces: NDArray[np.int32] | None = None


RAMPS = ("linear", "smoothstep")  # of the shares of a joint's rotation over contours


@dataclass(slots=True, eq=False)
class ContourSurface:
    """A surface of a Segment organised in contours (DefBody): each contour turns as one piece.

    `points` (C,P,3) at rest in humanoid space, from top to bottom, each contour counter-clockwise seen from the top;
    `closed` False: contours are open, as in the front and back of a torso. `uv` (C,P,2), `colors` (C,P,3) sRGB, or None.
    `uv_corners` (C-1,F,4,2): texture coordinates of the corners of faces, where a border of the map runs between points;
    F faces between two contours, P of them, P-1 where `closed` is False, each from its upper left corner on: upper right,
    lower right, lower left. None: those of the points.
    The first `fixed_upper` contours stay with the parent; over the next `upper` the rotation of the surface's own joint
    is taken up, over the last `lower` half of that of the next joint; contours before `extra` take all of it. `ramp`: how
    the share grows over the contours of a limb, "linear" or "smoothstep".
    `diversion` 0..1 takes back how far contours swing aside; `mitre` 0..1 keeps bends thick; `recentre`: contours keep
    their distances from the bone; `spread`: the part of the rotation about the limb is spread over the whole surface.
    `bulge` 0..1: how much wider its middle gets, as by a muscle, where the next joint is fully bent.
    `tilt` 0..1 says how far its contours, as they are, fan about the axis of the knee or elbow. `bands`: from each of
    these contours on, faces look like that material instead.
    """

    name: str
    points: Array
    closed: bool = True
    fixed_upper: int = 0
    upper: int = 0
    lower: int = 0
    extra: int = 0
    ramp: str = "linear"
    diversion: float = 0.0
    mitre: float = 0.0
    recentre: bool = False
    spread: bool = False
    bulge: float = 0.0
    tilt: float = 0.0
    uv: Array | None = None
    uv_corners: Array | None = None
    colors: Array | None = None
    material: Material = field(default_factory=Material)
    bands: tuple[tuple[int, Material], ...] = ()
    node: Node | None = None


@dataclass(slots=True, eq=False)
class Viewpoint:
    """A camera in a Site: `position` and `orientation` (axis-angle) in the Site's frame, `field_of_view` in radians."""

    description: str = ""
    position: Array = field(default_factory=lambda: _vec(0, 0, 10))
    orientation: Array = field(default_factory=lambda: _vec(0, 0, 1, 0))
    field_of_view: float = 0.785398
    node: Node | None = None


@dataclass(slots=True, eq=False)
class Site(Bounded):
    """A named place: `_tip` end effector, `_view` camera, `_pt` feature point. `center` in the parent's frame.

    `children` are the nodes that hang there beside shapes and viewpoints (lights, sensors, Inlines).
    """

    name: str
    center: Array = field(default_factory=lambda: _vec(0, 0, 0))
    translation: Array = field(default_factory=lambda: _vec(0, 0, 0))
    rotation: Array = field(default_factory=lambda: _vec(0, 0, 1, 0))
    scale: Array = field(default_factory=lambda: _vec(1, 1, 1))
    scale_orientation: Array = field(default_factory=lambda: _vec(0, 0, 1, 0))
    shapes: list[Shape] = field(default_factory=list)
    node: Node | None = None
    viewpoints: list[Viewpoint] = field(default_factory=list)
    children: list[Node] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Segment(Bounded):
    """A body part. `mass` (kg) and `center_of_mass` (m, the joint's frame) are zero when not given.

    `moments_of_inertia` is a row-major 3x3 in kg m2 about the centre of mass, axes of the joint's frame.
    `coord` (n,3) are the points that `displacers` index: the very array of the shapes that use it, None when not given.
    `children` are the nodes that hang there beside shapes and Sites.
    """

    name: str
    mass: float = 0.0
    center_of_mass: Array = field(default_factory=lambda: _vec(0, 0, 0))
    moments_of_inertia: Array = field(default_factory=lambda: np.zeros(9))
    shapes: list[Shape] = field(default_factory=list)
    sites: list[Site] = field(default_factory=list)
    displacers: list[Displacer] = field(default_factory=list)
    node: Node | None = None
    coord: Array | None = None
    children: list[Node] = field(default_factory=list)
    contours: list[ContourSurface] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Joint(Bounded):
    """A joint with its subtree. `llimit`, `ulimit` hold 0 to 3 angles (radians); empty means free."""

    name: str
    center: Array = field(default_factory=lambda: _vec(0, 0, 0))
    translation: Array = field(default_factory=lambda: _vec(0, 0, 0))
    rotation: Array = field(default_factory=lambda: _vec(0, 0, 1, 0))
    scale: Array = field(default_factory=lambda: _vec(1, 1, 1))
    scale_orientation: Array = field(default_factory=lambda: _vec(0, 0, 1, 0))
    joints: list[Joint] = field(default_factory=list)
    segments: list[Segment] = field(default_factory=list)
    sites: list[Site] = field(default_factory=list)
    displacers: list[Displacer] = field(default_factory=list)
    skin_coord_index: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    skin_coord_weight: Array = field(default_factory=_floats)
    llimit: Array = field(default_factory=_floats)
    ulimit: Array = field(default_factory=_floats)
    limit_orientation: Array = field(default_factory=lambda: _vec(0, 0, 1, 0))
    stiffness: Array = field(default_factory=lambda: _vec(0, 0, 0))
    node: Node | None = None

    def walk(self) -> Iterator[Joint]:
        """This joint and all below it, depth first, parents before children. No recursion."""
        stack = [self]
        while stack:
            joint = stack.pop()
            yield joint
            stack.extend(reversed(joint.joints))


@dataclass(slots=True, eq=False)
class MotionData:
    """HAnimMotion (X3D 4.0): `values` (frames, channels) as in the file, angles in degrees.

    `joints` one name per group ("IGNORED" skips it), `channels` one tuple of channel names per group.
    `channels_enabled` has one flag per group or one per channel; [] means all. Played are the frames `start_frame` to
    `end_frame` (0: the last) in steps of `frame_increment`, each for `frame_duration` seconds.
    """

    name: str
    joints: list[str]
    channels: list[tuple[str, ...]]
    values: Array
    frame_duration: float = 0.1
    enabled: bool = True
    loop: bool = True
    description: str = ""
    node: Node | None = None
    loa: int = -1
    start_frame: int = 0
    end_frame: int = 0
    frame_increment: int = 1
    frame_index: int = 0
    channels_enabled: list[bool] = field(default_factory=list)
    metadata: Node | None = None
    extras: dict[str, object] = field(default_factory=dict)


@dataclass(slots=True, eq=False)
class Pose(Described):
    """HAnimPose (X3D 4.1 draft): where `joints` (flat, placed only) shall go within `transition_duration` seconds."""

    name: str
    enabled: bool = True
    loa: int = -1
    transition_duration: float = 0.0
    joints: list[Joint] = field(default_factory=list)
    node: Node | None = None


@dataclass(slots=True, eq=False)
class Track:
    """One interpolator that a TimeSensor drives: `target` object name, its `field`, keys (k,) in 0..1, values (k, n).

    `target` is a joint's, segment's, site's or displacer's name, or "" for the humanoid itself. Values of "point", from
    a CoordinateInterpolator, are whole sets of points (k, 3n): of the skin when `target` is "", else of the segment, or
    of the shape in the skin that has points of its own.
    """

    target: str
    field: str  # "rotation" | "translation" | "scale" | "center" | "weight" | "point"
    keys: Array
    values: Array
    interval: float = 1.0
    loop: bool = True
    timer: str = ""  # DEF of the TimeSensor: tracks of one clip share it
    rate: float = 0.0  # keys per second when each is a frame of a clip, 0 when nobody said so


@dataclass(slots=True, eq=False)
class Humanoid(Bounded):
    """One H-Anim figure. `skeleton` holds its root joints; `skin` shapes share `skin_coord` (v,3).

    `info` are the `key=value` strings; `info_given` those of the file, so that its order and wording survive.
    X3D 4.0: `binding`, `skin_binding_coords` (v,3), `skin_binding_normals`. 4.1 draft: `motions_enabled` (one per
    motion), `skin_displacers` (at rest, over `skin_coord`), `poses` and other nodes in `children`.
    """

    name: str = ""
    version: str = "2.0"
    loa: int = -1
    info: dict[str, str] = field(default_factory=dict)
    skeletal_configuration: str = "BASIC"
    skeleton: list[Joint] = field(default_factory=list)
    sites: list[Site] = field(default_factory=list)  # Sites that hang in the skeleton field itself
    viewpoints: list[Site] = field(default_factory=list)
    skin: list[Shape] = field(default_factory=list)
    skin_coord: Array = field(default_factory=lambda: np.zeros((0, 3)))
    skin_normal: Array | None = None
    center: Array = field(default_factory=lambda: _vec(0, 0, 0))
    translation: Array = field(default_factory=lambda: _vec(0, 0, 0))
    rotation: Array = field(default_factory=lambda: _vec(0, 0, 1, 0))
    scale: Array = field(default_factory=lambda: _vec(1, 1, 1))
    scale_orientation: Array = field(default_factory=lambda: _vec(0, 0, 1, 0))
    binding: dict[str, tuple[Array, Array, Array]] = field(default_factory=dict)  # T, R, S of a joint
    motions: list[MotionData] = field(default_factory=list)
    tracks: list[Track] = field(default_factory=list)
    scene: Scene | None = None  # the file it came from
    made_from: object = None  # what a modelling function made it from; stays in memory
    node: Node | None = None
    info_given: tuple[str, ...] = ()
    skin_binding_coords: Array | None = None
    skin_binding_normals: Array | None = None
    motions_enabled: list[bool] = field(default_factory=list)
    skin_displacers: list[Displacer] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    children: list[Node] = field(default_factory=list)

    def copied(self) -> Humanoid:
        """A copy with joints and segments of its own, whose lists may be changed; arrays, shapes and sites are shared."""
        copies = {
            id(j): replace(
                j,
                joints=[],
                segments=[
                    replace(
                        s,
                        shapes=list(s.shapes),
                        sites=list(s.sites),
                        displacers=list(s.displacers),
                        contours=list(s.contours),
                    )
                    for s in j.segments
                ],
                sites=list(j.sites),
                displacers=list(j.displacers),
            )
            for j in self.joints()
        }
        for joint in self.joints():
            copies[id(joint)].joints = [copies[id(j)] for j in joint.joints]
        return replace(self, skeleton=[copies[id(j)] for j in self.skeleton])

    def settled(self) -> Humanoid:
        """This humanoid, after its shapes got new points: a Segment's `coord` that none of them has any more goes."""
        for segment in self.segments():
            if segment.coord is not None and not any(s.points is segment.coord for s in segment.shapes):
                segment.coord = None
        return self

    def joints(self) -> list[Joint]:
        """Every joint once, depth first, parents before children."""
        return [joint for root in self.skeleton for joint in root.walk()]

    def joint(self, name: str) -> Joint:
        """The joint of that name; KeyError when absent."""
        for joint in self.joints():
            if joint.name == name:
                return joint
        raise KeyError(name)

    def segments(self) -> list[Segment]:
        return [s for j in self.joints() for s in j.segments]

    def all_sites(self) -> list[Site]:
        """Sites of the skeleton field, of joints and of segments (viewpoints apart)."""
        own = [s for j in self.joints() for s in [*j.sites, *(t for g in j.segments for t in g.sites)]]
        return [*self.sites, *own]

    def displacers(self) -> list[Displacer]:
        """The humanoid's own displacers, those of joints, then those of segments, in tree order."""
        joints = self.joints()
        of_joints = [d for j in joints for d in j.displacers]
        return [*self.skin_displacers, *of_joints, *(d for j in joints for s in j.segments for d in s.displacers)]
