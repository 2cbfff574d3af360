"""A small figure that nothing is wrong with; tests break it on purpose."""

from __future__ import annotations

import numpy as np

from vitruvian.formats.x3d import parse_x3d
from vitruvian.hanim import tables
from vitruvian.hanim.graph import Scene
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Material, Segment, Shape, Site, Track

# A root, a spine joint, an arm of two joints, a little skin.
GOOD = """<X3D profile="Immersive" version="4.0">
<head><component name="HAnim" level="1"/></head>
<Scene>
<HAnimHumanoid DEF="hanim_Tin" name="Tin" version="2.0" loa="-1" info='"gender=none" "height=1.7"'>
<HAnimJoint DEF="hanim_humanoid_root" name="humanoid_root" center="0 0.8 0" skinCoordIndex="0 1" skinCoordWeight="1 1"
 containerField="skeleton">
<HAnimSegment DEF="hanim_sacrum" name="sacrum" mass="3">
<Shape><Appearance><Material diffuseColor="1 0 0" transparency="0.25"/></Appearance>
<IndexedFaceSet coordIndex="0 1 2 3 -1"><Coordinate point="0 0 0 1 0 0 1 1 0 0 1 0"/></IndexedFaceSet></Shape>
<HAnimSite DEF="hanim_navel_pt" name="navel_pt" translation="0 1 0.1"/>
</HAnimSegment>
<HAnimJoint DEF="hanim_vl5" name="vl5" center="0 1 0" llimit="-1 -1 -1" ulimit="1 1 1"
 skinCoordIndex="2 3" skinCoordWeight="1 1">
<HAnimJoint DEF="hanim_l_shoulder" name="l_shoulder" center="0.2 1.4 0"
 skinCoordIndex="4 5 6" skinCoordWeight="1 0.5 0.5">
<HAnimJoint DEF="hanim_l_elbow" name="l_elbow" center="0.2 1.1 0" skinCoordIndex="5 6 7" skinCoordWeight="0.5 0.5 1"/>
</HAnimJoint></HAnimJoint></HAnimJoint>
<Shape DEF="hanim_skin" containerField="skin"><Appearance><Material/></Appearance>
<IndexedFaceSet DEF="hanim_faces" coordIndex="0 1 2 -1 2 3 4 -1 4 5 6 7 -1">
<Coordinate DEF="hanim_skin_coords" point="0 0.8 0 0.1 0.8 0 0.1 1 0 0 1 0 0.2 1.4 0 0.3 1.4 0 0.3 1.1 0 0.2 1.1 0"/>
</IndexedFaceSet></Shape>
<Coordinate USE="hanim_skin_coords" containerField="skinCoord"/>
<HAnimJoint USE="hanim_humanoid_root" containerField="joints"/>
<HAnimJoint USE="hanim_vl5" containerField="joints"/>
<HAnimJoint USE="hanim_l_shoulder" containerField="joints"/>
<HAnimJoint USE="hanim_l_elbow" containerField="joints"/>
<HAnimSegment USE="hanim_sacrum" containerField="segments"/>
<HAnimSite USE="hanim_navel_pt" containerField="sites"/>
</HAnimHumanoid>
<TimeSensor DEF="Clock" cycleInterval="2" loop="true"/>
<OrientationInterpolator DEF="Turn" key="0 0.5 1" keyValue="0 0 1 0 0 0 1 1 0 0 1 0"/>
<ROUTE fromNode="Clock" fromField="fraction_changed" toNode="Turn" toField="set_fraction"/>
<ROUTE fromNode="Turn" fromField="value_changed" toNode="hanim_l_shoulder" toField="set_rotation"/>
</Scene>
</X3D>
"""

MOTION = (
    '<HAnimMotion DEF="run" joints="humanoid_root vl5" channels="3 Xposition Yposition Zposition 1 Xrotation" '
    'values="0 0 0 0 0 0 0 45" enabled="true" loop="true" frameDuration="0.1"/></HAnimHumanoid>'
)

VRML = """#VRML V2.0 utf8
PROTO Joint [ exposedField SFString name "" exposedField SFVec3f center 0 0 0 exposedField SFRotation rotation 0 0 1 0
  exposedField MFNode children [ ] exposedField MFFloat llimit [ ] exposedField MFFloat ulimit [ ] ]
{ Transform { center IS center rotation IS rotation children IS children } }
PROTO Segment1_1 [ exposedField SFString name "" exposedField SFFloat mass 7 exposedField MFNode children [ ] ]
{ Group { children IS children } }
PROTO Body [ exposedField SFString name "" exposedField SFString version "1.1"
  exposedField MFNode humanoidBody [ ] exposedField MFNode skeleton [ ] exposedField MFNode joints [ ] ]
{ Group { children IS humanoidBody } }
DEF Nobody Body { name "nobody" skeleton [ ] humanoidBody [
  DEF nobody_root Joint { name "HumanoidRoot" center 0 0.9 0 children [
    DEF nobody_sacrum Segment1_1 { name "sacrum" children Transform { translation 0 1 0 scale 2 2 2
      children Shape { geometry Box { size 1 1 1 } } } }
    DEF nobody_l_hip Joint { name "l_hip" center 0.1 0.9 0 rotation 1 0 0 0.5 }
  ] } ]
  joints [ USE nobody_root USE nobody_l_hip ] }
"""


def broken(old: str, new: str, count: int = 1) -> Scene:
    """The good figure with one thing replaced."""
    assert old in GOOD, old
    return parse_x3d(GOOD.replace(old, new, count).encode(), "tin.x3d")


def good() -> Scene:
    return parse_x3d(GOOD.encode(), "tin.x3d")


def typed(loa: int = 1, *, skin: bool = True, version: str = "2.0") -> Humanoid:
    """A typed figure of that level: a quad of skin (or a triangle of segment geometry) per joint, a site, a clip."""
    centers = tables.default_centers(version)
    names = tables.joints_at(loa, version)
    table = tables.joints(version)
    joints = {n: Joint(n, center=centers[n]) for n in names}
    for n in names:
        parent = tables.parent_at(n, loa, version)
        if parent is not None:
            joints[parent].joints.append(joints[n])
        joints[n].segments.append(Segment(table[n].segment, mass=1.5))
    points, triangles = [], []
    look = Material("skin", (0.8, 0.6, 0.5), roughness=0.5)
    for k, n in enumerate(names):
        quad = centers[n] + 0.02 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 1]])
        corner = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
        if skin:
            points.append(quad)
            triangles.append(corner + 4 * k)
            joints[n].skin_coord_index = np.arange(4 * k, 4 * k + 4, dtype=np.int32)
            joints[n].skin_coord_weight = np.array([1, 1, 0.75, 0.5])
        else:
            joints[n].segments[0].shapes.append(Shape(n, corner, points=quad, material=look))
    h = Humanoid("Ada", version, loa, skeleton=[joints[names[0]]], info={"age": "36"})
    if skin:
        h.skin_coord = np.concatenate(points)
        every = np.concatenate(triangles)
        half = len(every) // 2
        uv = np.linspace(0, 1, 2 * len(h.skin_coord)).reshape(-1, 2)
        h.skin = [
            Shape("front", every[:half], uv=uv, uv_triangles=every[:half].copy(), material=look),
            Shape("back", every[half:], colors=np.full((len(h.skin_coord), 3), 0.25), material=Material("shirt")),
        ]
        joints["skullbase"].displacers.append(
            Displacer("blink_action", np.array([0, 1], np.int32), np.array([[0, 0.01, 0], [0, -0.01, 0]]), weight=0.5)
        )
    joints["skullbase"].segments[0].sites.append(Site("skull_vertex_tip", translation=np.array([0, 1.75, 0])))
    joints["skullbase"].sites.append(Site("front_view", translation=np.array([0, 1.6, 2.0])))
    joints["l_shoulder"].llimit, joints["l_shoulder"].ulimit = np.full(3, -1.5), np.full(3, 1.25)
    joints["l_shoulder"].stiffness = np.array([0.5, 0, 0])
    keys = np.array([0, 0.5, 1])
    turn = np.array([[0, 0, 1, 0], [0, 0, 1, 1.5], [0, 0, 1, 0]], float)
    walk = np.array([[0, 0, 0], [0, 0, 0.5], [0, 0, 1]], float)
    h.tracks = [
        Track("l_shoulder", "rotation", keys, turn, 2.0, True, "wave"),
        Track(names[0], "translation", keys, walk, 2.0, True, "wave"),
    ]
    return h
