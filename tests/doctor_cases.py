"""For each rule of the doctor a file that breaks it in one way and one that keeps it.

Both are made from a small good figure (or a whole one where a rule needs it) by replacing one thing.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

from scene_figure import GOOD, MOTION, VRML, typed
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim.build import scene_of


@dataclass(frozen=True)
class Case:
    """`message` a piece of what is said; `left` the rules that the repair leaves or uncovers (`--also` named)."""

    rule: str
    bad: str
    message: str
    good: str = GOOD
    suffix: str = ".x3d"
    schema: bool = False
    left: frozenset[str] = frozenset()
    mended: bool = True  # whether the repair of an "auto" rule has an answer for this one
    touched: int = 8  # lines of the file that the repair may change


def swap(old: str, new: str, text: str = GOOD) -> str:
    assert old in text, old
    return text.replace(old, new, 1)


@cache
def whole(loa: int = 1, skin: bool = True) -> str:
    """A whole figure with default centres whose weights sum to one."""
    h = typed(loa, skin=skin)
    for j in h.joints():
        j.skin_coord_weight = j.skin_coord_weight * 0 + 1
    return print_x3d(scene_of([h])[0])[0].replace("'", "@").replace('"', "'").replace("@", '"')


def vrml(text: str = VRML) -> str:
    return text.replace("rotation 1 0 0 0.5", "")


SKIN_COORD = '<Coordinate USE="hanim_skin_coords" containerField="skinCoord"/>'
ROOT_JOINT = '<HAnimJoint USE="hanim_humanoid_root" containerField="joints"/>'
VL5_JOINT = '<HAnimJoint USE="hanim_vl5" containerField="joints"/>'
SITE = '<HAnimSite USE="hanim_navel_pt" containerField="sites"/>'
ELBOW = '<HAnimJoint DEF="hanim_l_elbow"'
FEED = '<ROUTE fromNode="Clock" fromField="fraction_changed" toNode="Turn" toField="set_fraction"/>'
DRIVE = '<ROUTE fromNode="Turn" fromField="value_changed" toNode="hanim_l_shoulder" toField="set_rotation"/>'
ENDS = "</HAnimJoint></HAnimJoint></HAnimJoint>"
DISPLACER = '<HAnimDisplacer DEF="d" name="bulge_action" weight="1" coordIndex="5 6" displacements="0 0 1 0 0 2"/>'
BULGE = swap(ENDS, DISPLACER + ENDS)
RUN = swap("</HAnimHumanoid>", MOTION)
TEXTURE = '<Appearance><ImageTexture url=\'"data:image/png;base64,AA" "skin.png"\'/></Appearance>'
SCRIPT = (
    '<Script DEF="Mind"><field name="turn" type="SFRotation" accessType="outputOnly"/>'
    "<![CDATA[ecmascript: function initialize() { }]]></Script>"
)
TOUCH = (
    '<TouchSensor DEF="Press"/><TimeSensor DEF="Clock" cycleInterval="2"/>'
    '<ROUTE fromNode="Press" fromField="touchTime" toNode="Clock" toField="startTime"/>'
)
TRIGGERED = TOUCH.replace(
    '<ROUTE fromNode="Press" fromField="touchTime" toNode="Clock" toField="startTime"/>',
    '<TimeTrigger DEF="Go"/><ROUTE fromNode="Press" fromField="isActive" toNode="Go" toField="set_boolean"/>'
    '<ROUTE fromNode="Go" fromField="triggerTime" toNode="Clock" toField="startTime"/>',
)
WIDE = (
    '<HAnimJoint DEF="hanim_sacroiliac" name="sacroiliac" center="0 0.81 0" skinCoordIndex="0" skinCoordWeight="0.2"/>'
    '<HAnimJoint DEF="hanim_l_hip" name="l_hip" center="0.1 0.8 0" skinCoordIndex="0" skinCoordWeight="0.2"/>'
    '<HAnimJoint DEF="hanim_r_hip" name="r_hip" center="-0.1 0.8 0" skinCoordIndex="0" skinCoordWeight="0.2"/>'
    '<HAnimJoint DEF="hanim_l_knee" name="l_knee" center="0.1 0.4 0" skinCoordIndex="0" skinCoordWeight="0.2"/>'
)
LISTED = "".join(
    f'<HAnimJoint USE="hanim_{n}" containerField="joints"/>' for n in ("sacroiliac", "l_hip", "r_hip", "l_knee")
)
MANY = swap('skinCoordIndex="0 1" skinCoordWeight="1 1"', 'skinCoordIndex="0 1" skinCoordWeight="0.2 1"').replace(
    '<HAnimJoint DEF="hanim_vl5"', WIDE + '<HAnimJoint DEF="hanim_vl5"'
)
MANY = MANY.replace(ROOT_JOINT, ROOT_JOINT + LISTED)
UNSKINNED = re.sub(r'\s*skinCoord(Weight|Index)="[^"]*"', "", GOOD).replace(SKIN_COORD, "")
UNSKINNED = re.sub(r'<Shape DEF="hanim_skin".*?</Shape>', "", UNSKINNED, flags=re.DOTALL)
SEAMED = re.sub(r'<Shape DEF="hanim_skin".*?</Shape>', "", GOOD, flags=re.DOTALL)
BESIDE = swap(
    SKIN_COORD,
    '<Coordinate DEF="hanim_skin_coords" containerField="skinCoord" point="0 0.8 0 0.1 0.8 0 0.1 1 0 0 1 0 0.2 1.4 0 '
    '0.3 1.4 0 0.3 1.1 0 0.2 1.1 0"/>',
    SEAMED,
).replace(
    "</HAnimHumanoid>",
    '</HAnimHumanoid><Shape DEF="hanim_skin"><IndexedFaceSet coordIndex="0 1 2 -1 4 5 6 7 -1">'
    '<Coordinate USE="hanim_skin_coords"/></IndexedFaceSet></Shape>',
)
SEATED = '<Coordinate DEF="hanim_sacrum_coords" point="0 0 0 1 0 0 1 1 0 0 1 0"/></IndexedFaceSet></Shape>'
SEATED = swap('<Coordinate point="0 0 0 1 0 0 1 1 0 0 1 0"/></IndexedFaceSet></Shape>', SEATED + (
    '<Coordinate USE="hanim_sacrum_coords"/>'
))  # fmt: skip


TILTED = swap('<HAnimJoint DEF="hanim_vl5"', '<HAnimJoint DEF="hanim_sacroiliac" name="sacroiliac" center="0 0.82 0">'
              '<HAnimJoint DEF="hanim_vl5"')  # fmt: skip
TILTED = swap(ENDS, ENDS + "</HAnimJoint>", TILTED).replace(
    ROOT_JOINT, ROOT_JOINT + '<HAnimJoint USE="hanim_sacroiliac" containerField="joints"/>'
)


def whole_center(name: str, center: str, text: str) -> str:
    """The whole figure with another centre of one joint."""
    found = re.sub(rf'(name="{name}"[^>]*? center=")[^"]*"', rf'\g<1>{center}"', text, count=1)
    assert found != text
    return found


CASES: list[Case] = [
    Case("F01", swap('version="4.0"', 'version="5.7"'), "version '5.7'"),
    Case("F01", "DEF a Group { }\n", "there is no header", "#VRML V2.0 utf8\nDEF a Group { }\n", ".wrl"),
    Case("F01", "#x3d 4.0\nGroup { }\n", "the header '#x3d 4.0' is none", "#X3D V4.0 utf8\nPROFILE Full\n", ".x3dv"),
    Case("F02", GOOD.replace("</Scene>", ""), "mismatched tag"),
    Case("F03", swap('name="vl5"', 'name="vl5" centre="0 0 0"'), "no field centre"),
    Case("F03", swap("<TimeSensor", '<TimeSensr DEF="a"/><TimeSensor'), "nobody knows a node TimeSensr"),
    Case("F03", vrml().replace('name "sacrum"', 'name "sacrum" weigth 3'),
         "the PROTO ignores it", vrml(), ".wrl"),
    Case("F04", swap('DEF="hanim_skin"', 'DEF="hanim_faces"'), "given twice"),
    Case("F04", GOOD.replace('"Turn"', '"Turn it"'), "holds a blank"),
    Case("F05", swap('USE="hanim_navel_pt"', 'USE="hanim_nabel_pt"'), "USE hanim_nabel_pt has no DEF before it"),
    Case("F06", swap(' containerField="skeleton"', ""), "without containerField"),
    Case("F06", swap(DISPLACER, DISPLACER.replace("/>", ' containerField="children"/>'), BULGE), "stands in children",
         BULGE),
    Case("F06", swap(ELBOW, ELBOW + ' containerField="skeleton"'), "stands in skeleton of HAnimJoint"),
    Case("F07", swap('<component name="HAnim" level="1"/>', ""), "without component HAnim"),
    Case("F07", swap('profile="Immersive"', 'profile="Core"'), "without component Interpolation"),
    Case("F07", swap(' profile="Immersive"', ""), "gives no profile"),
    Case("F08", swap("<Appearance><Material/></Appearance>", TEXTURE.replace("data:", "http:")), "not beside the scene",
         swap("<Appearance><Material/></Appearance>", TEXTURE)),
    Case("F09", swap("<TimeSensor", '<Group bboxSize="1 2"/><TimeSensor'), "bboxSize", schema=True),
    Case("V01", swap('version="2.0"', 'version="200x"'), "X3D knows"),
    Case("V01", vrml().replace('name "nobody" sk', 'name "nobody" version "2.0" sk'), "VRML97 knows", vrml(), ".wrl"),
    Case("V02", swap('loa="1"', 'loa="2"', whole()), "53 of its joints are missing", whole()),
    Case("V03", swap('loa="1"', 'loa="0"', whole()), "17 joints of higher levels", whole()),
    Case("V04", swap('name="l_radiocarpal"', 'name="l_wrist"', whole()), "with older names (l_wrist)", whole()),
    Case("V04", swap('name="l_tarsal_proximal_phalanx_2"', 'name="l_middistal"', whole()), "1 segment of a 2.0", whole()),
    Case("V05", swap('name="humanoid_root"', 'name="HumanoidRoot"'), "the root is called HumanoidRoot"),
    Case("N01", swap('name="vl5" ', ""), "nothing can address it"),
    Case("N02", swap('name="l_elbow"', 'name="l_ellbow"'), "not standard though close"),
    Case("N02", swap('name="l_elbow"', 'name="LeftElbow"'), "not standard though close"),
    Case("N02", swap('name="sacrum"', 'name="Sacrum"'), "segment name Sacrum"),
    Case("N03", swap('name="l_elbow"', 'name="tail"'), "taken for an addition"),
    Case("N04", swap('name="l_elbow"', 'name="l_shoulder"'), "2 joints are called l_shoulder"),
    Case("N05", GOOD.replace('"hanim_vl5"', '"spine"'), "1 DEF does not start"),
    Case("N06", swap('name="navel_pt"', 'name="navel"'), "1 site has none"),
    Case("N06", swap("bulge_action", "bulge", BULGE), "1 displacer has none", BULGE),
    Case("N06", SEATED.replace("hanim_sacrum_coords", "seat"), "not called SEGMENT_coords", SEATED),
    Case("N07", swap('name="sacrum"', 'name="l_thigh"'), "whose segment is sacrum"),
    Case("N08", swap(' name="Tin"', ""), "no name"),
    Case("N08", swap("<TimeSensor", '<HAnimHumanoid DEF="b" name="Tin"/><TimeSensor'), "2 humanoids are called Tin",
         left=frozenset({"T01"})),
    Case("T01", swap('name="humanoid_root"', 'name="sacroiliac"'), "expected humanoid_root"),
    Case("T01", swap("<TimeSensor", '<HAnimHumanoid DEF="b" name="Tim"/><TimeSensor'), "the skeleton is empty"),
    Case("T02", swap('name="vl5" center', 'name="l_hip" center'), "l_shoulder hangs under l_hip"),
    Case("T03", TILTED, "vl5 hangs under sacroiliac"),
    Case("T04", swap(SITE, ROOT_JOINT.replace("joints", "skeleton") + SITE), "reached twice"),
    Case("T05", swap('name="l_elbow"', 'name="l_radiocarpal"'),
         "missing between joints that are there (l_elbow"),
    Case("P01", swap('center="0 1 0"', 'center="0 1 0" rotation="1 0 0 0.4"'), "not at rest", touched=12),
    Case("P02", swap('center="0.2 1.1 0"', ""), "1 joint has no center (l_elbow)"),
    Case("P03", whole_center("r_knee", "-0.2 0.5 0", whole()), "is no mirror image", whole()),
    Case("P04", whole_center("l_radiocarpal", "0.7 1.4 0", whole()), "the left arm is", whole()),
    Case("P05", swap('loa="1"', 'loa="1" scale="100 100 100"', whole()), "the units are not metres", whole()),
    Case("P05", swap('loa="1"', 'loa="1" translation="0 3 0"', whole()), "m above the ground", whole()),
    Case("P05", swap('loa="1"', 'loa="1" translation="2 0 0"', whole()), "off the Y axis", whole()),
    Case("P06", swap('center="0 1 0"', 'center="0 1 nan"'), "entry 2 is not a finite number", left=frozenset({"P02"})),
    Case("P06", swap('center="0 1 0"', 'center="0 1"'), "expected 3 numbers, found 2", left=frozenset({"P02"})),
    Case("P06", swap('center="0 1 0"', 'center="0 1 0" scale="1 0 1"'), "zero collapses", mended=False),
    Case("P06", swap('center="0 1 0"', 'center="0 1 0" limitOrientation="0 2 0 1"'), "axis has length 2"),
    Case("P06", swap("0.1 0.8 0 0.1", "0.1 inf 0 0.1"), "point: entry 4 is not a finite number"),
    Case("P07", swap('center="0.2 1.1 0"', 'center="0.2 2.4 0"'), "1 joint is outside the mesh (l_elbow"),
    Case("S01", swap('"1 0.5 0.5"', '"1 0.5"'), "3 skinCoordIndex but 2 skinCoordWeight"),
    Case("S01", swap('"1 0.5 0.5"', '"1 0.5 0.5 7"'), "3 skinCoordIndex but 4 skinCoordWeight"),
    Case("S02", swap('"4 5 6"', '"4 5 99"'), "outside 0..7 (entry 2 is 99)"),
    Case("S03", swap('"1 0.5 0.5"', '"1 0.5 0.4"'), "do not sum to 1 (point 6: 0.9)"),
    Case("S04", swap('skinCoordIndex="0 1" skinCoordWeight="1 1"', 'skinCoordIndex="0" skinCoordWeight="1"'),
         "1 of 8 skin"),
    Case("S05", swap('skinCoordIndex="0 1" skinCoordWeight="1 1"', 'skinCoordIndex="0 1" skinCoordWeight="1 -1"'),
         "0..1", left=frozenset({"S04"})),
    Case("S05", re.sub(r'skinCoordWeight="[^"]*"', lambda m: re.sub(r"[\d.]+", "0", m[0]), GOOD),
         "all weights are zero", mended=False),
    Case("S06", swap('"4 5 6"', '"4 5 5"'), "1 point twice"),
    Case("S07", MANY, "1 point has more than 4 influences: glTF and VRM export prunes them, at most 0.2"),
    Case("S08", swap(SKIN_COORD, SKIN_COORD + '<Normal vector="0 0 1" containerField="skinNormal"/>'),
         "1 vectors for 8 points"),
    Case("S09", swap("4 5 6 7 -1", "4 5 6 8 -1"), "outside 0..7 (entry 11: 8)"),
    Case("S09", swap("4 5 6 7 -1", "4 5 6 7 -1 0 1 -1"), "1 face with fewer"),
    Case("S09", swap("4 5 6 7 -1", "4 5 6 7 -1 3 3 5 -1"), "1 face with fewer"),
    Case("S09", swap('coordIndex="0 1 2 3 -1"', 'coordIndex="0 1 2 9 -1"'), "outside 0..3 (entry 3: 9)"),
    Case("D01", BULGE.replace('"5 6" disp', '"5 60" disp'), "entry 1: 60",
         BULGE),
    Case("D01", BULGE.replace('"5 6" disp', '"5" disp'), "2 displacem", BULGE),
    Case("D02", swap("</HAnimJoint></HAnimJoint></HAnimJoint>", '</HAnimJoint></HAnimJoint>'
         + DISPLACER.replace("5 6", "0 1") + "</HAnimJoint>", UNSKINNED), "without skinCoord", BULGE),
    Case("D02", BULGE, "the schema refuses a displacer under a joint", schema=True, mended=False),
    Case("D03", BULGE.replace(' weight="1"', ""), "weight 0 and no ROUTE", BULGE),
    Case("D04", swap('mass="3"', 'mass="-3"'), "mass -3 is negative"),
    Case("D04", swap('mass="3"', 'mass="3" momentsOfInertia="1 0 0 0 1 0 0 0 3"'), "belongs to no solid"),
    Case("D04", swap('mass="3"', 'momentsOfInertia="1 0.5 0 0 1 0 0 0 1"'), "not symmetric"),
    Case("D04", swap('mass="3"', 'mass="3" centerOfMass="0 7 0"'), "is outside the segment's mesh"),
    Case("D05", swap('llimit="-1 -1 -1"', 'llimit="-1 -1 2"'), "llimit is above ulimit"),
    Case("D05", swap('llimit="-1 -1 -1"', 'llimit="-1 -1"'), "expected 0 or 3"),
    Case("D05", swap('llimit="-1 -1 -1"', 'llimit="-1 -1 -1" stiffness="2 0 0"'), "stiffness is outside"),
    Case("D06", swap("<TimeSensor", '<HAnimSite DEF="lost" name="lost_pt"/><TimeSensor'), "1 site hangs under no joint"),
    Case("M01", swap(VL5_JOINT, ""), "1 joint of the skeleton missing in joints (vl5)", touched=12),
    Case("M02", swap(VL5_JOINT, VL5_JOINT * 2), "1 joint is listed twice", touched=12),
    Case("M03", swap(VL5_JOINT, VL5_JOINT + '<HAnimJoint DEF="x" name="vl4" containerField="joints"/>'), "(vl4)",
         touched=12),
    Case("M04", swap(SKIN_COORD, ""), "skinCoord is missing"),
    Case("M04", swap(SKIN_COORD, '<Coordinate containerField="skinCoord" point="0 0.8 0 0.1 0.8 0 0.1 1 0 0 1 0 0.2 1.4 '
         '0 0.3 1.4 0 0.3 1.1 0 0.2 1.1 0"/>'), "is a copy of skinCoord"),
    Case("M05", BESIDE, "skin is empty", touched=24),
    Case("M06", re.sub(r'\s*skinCoord(Weight|Index)="[^"]*"', "", GOOD), "no joint has weights"),
    Case("M07", swap('toNode="hanim_l_shoulder"', 'toNode="l_shoulder"'), "there is no DEF l_shoulder"),
    Case("M07", swap('fromField="value_changed"', 'fromField="valu_changed"'), "has no such field"),
    Case("M07", swap(DRIVE, '<ROUTE toNode="Turn" toField="value_changed" fromNode="hanim_l_shoulder" '
         'fromField="set_rotation"/>'), "the field is"),
    Case("M07", swap('toField="set_rotation"', 'toField="set_translation"'), "SFRotation does not fit SFVec3f",
         mended=False),
    Case("M08", swap(FEED, ""), "nothing drives the fraction"),
    Case("M08", swap(FEED, ""), "1 TimeSensor drives nothing"),
    Case("M08", swap(DRIVE, ""), "1 interpolator drives nothing"),
    Case("M09", swap('cycleInterval="2"', 'cycleInterval="0"'), "the clock never runs"),
    Case("M09", swap('cycleInterval="2"', 'enabled="false"'), "nothing switches it on"),
    Case("M09", swap('loop="true"', 'loop="false"'), "nothing starts it"),
    Case("M09", swap('loop="true"', 'loop="true" startTime="1" stopTime="7"'), "stopTime 7 is long past"),
    Case("M10", swap('key="0 0.5 1"', 'key="0 1"'), "2 keys but 3 key values"),
    Case("M10", swap('key="0 0.5 1"', 'key="0 0.7 0.5"'), "backwards"),
    Case("M10", swap('key="0 0.5 1"', 'key="0 0.5 2"'), "outside 0..1"),
    Case("M11", swap('keyValue="0 0 1 0 0 0 1 1', 'keyValue="0 0 1 0 0 1 0 0'), "1 interpolator gives the same value"),
    Case("M12", swap('<TimeSensor DEF="Clock" cycleInterval="2" loop="true"/>', TOUCH), "waits for TouchSensor Press"),
    Case("M12", swap('<TimeSensor DEF="Clock" cycleInterval="2" loop="true"/>', TRIGGERED), "waits for TouchSensor Press"),
    Case("M13", swap(FEED, FEED + DRIVE), "last writer wins"),
    Case("M13", RUN.replace('"humanoid_root vl5"', '"humanoid_root l_shoulder"'), "driven by the motion and by ROUTEs",
         RUN),
    Case("M14", RUN.replace(' enabled="true"', ""), "enabled is not given", RUN),
    Case("M14", RUN.replace('enabled="true"', 'enabled="false"'), "it stands still", RUN),
    Case("M14", swap('enabled="true" loop="true"', 'enabled="true"', RUN), "loop is not given", RUN),
    Case("M15", RUN.replace(' 45"', '"'), "7 values are not a multiple of 4", RUN, mended=False),
    Case("M15", RUN.replace('"humanoid_root vl5"', '"humanoid_root"'), "2 groups of channels for 1 joints", RUN,
         mended=False),
    Case("M15", swap("<HAnimMotion", '<HAnimMotion containerField="children"', RUN), "not in motions", RUN),
    Case("M16", RUN.replace('"humanoid_root vl5', '"HumanoidRoot vl5'), "joint HumanoidRoot", RUN),
    Case("M17", RUN.replace('"0.1"/></HAnimHumanoid>', '"0"/></HAnimHumanoid>'), "frameDuration 0", RUN),
    Case("M17", RUN.replace("<HAnimMotion", '<HAnimMotion frameIncrement="0"'), "frameIncrement 0", RUN),
    Case("M17", RUN.replace("<HAnimMotion", '<HAnimMotion startFrame="1" endFrame="1"'), "both 1", RUN),
    Case("M17", RUN.replace("<HAnimMotion", '<HAnimMotion channelsEnabled="false false"'), "FALSE for all", RUN),
    Case("M18", RUN.replace('values="0 0 0', 'values="0 96 0'), "further off than", RUN),
    Case("M18", swap('keyValue="0 0 1 0 0 0 1 1', 'keyValue="0 0 1 0 0 0 1 50'), "angles up to 50: degrees"),
    Case("M19", swap('loa="-1"', 'visible="false"'), "visible is FALSE"),
    Case("M19", GOOD.replace("<HAnimHumanoid", "<Switch><HAnimHumanoid").replace("</HAnimHumanoid>",
         "</HAnimHumanoid></Switch>"), "whichChoice -1", GOOD.replace("<HAnimHumanoid", '<Switch whichChoice="0">'
         "<HAnimHumanoid").replace("</HAnimHumanoid>", "</HAnimHumanoid></Switch>")),
    Case("M20", vrml().replace("exposedField MFNode joints [ ]", "exposedField MFNode joints [ ] exposedField MFNode "
         "skin [ ]").replace("joints [ USE", "skin [ Shape { geometry Box { } } ] joints [ USE"), "plain VRML browsers",
         vrml(), ".wrl"),
    Case("M21", swap(ELBOW, "<Shape><Box/></Shape>" + ELBOW), "1 shape stands in joint l_shoulder"),
    Case("M21", swap(SITE, "<Shape><Box/></Shape>" + SITE).replace("<Shape><Box/></Shape>" + SITE,
         '<Shape containerField="children"><Box/></Shape>' + SITE), "1 shape stands in humanoid Tin"),
    Case("M22", swap("</Scene>", SCRIPT + '<ROUTE fromNode="Mind" fromField="turn" toNode="hanim_l_elbow" '
         'toField="set_rotation"/></Scene>'), "driven by Script Mind"),
]  # fmt: skip
