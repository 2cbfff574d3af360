"""Every field of the standard's objects, in every version that has it: read, edited, written back, or said to be lost."""

from __future__ import annotations

import json
import warnings
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from scene_figure import MOTION, good, typed
from vitruvian.errors import VitruvianError
from vitruvian.formats.vrml import parse_vrml
from vitruvian.formats.vrml_writer import print_vrml
from vitruvian.formats.x3d import parse_x3d
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim import humanoid as model
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.graph import Node, Scene
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, MotionData, Pose, Segment, Site, Viewpoint
from vitruvian.hanim.members import APART, DRAFT, MEMBERS, WITHOUT_VALUE, Member, alike, available, has
from vitruvian.hanim.view import humanoids

TABLE = json.loads((ROOT / "src" / "vitruvian" / "hanim" / "data" / "node_fields.json").read_text())
CLASSES = {
    "Humanoid": Humanoid,
    "Joint": Joint,
    "Segment": Segment,
    "Site": Site,
    "Displacer": Displacer,
    "Motion": MotionData,
    "Pose": Pose,
}
VERSIONS = ("1.0", "2.0", DRAFT, "200x", "1.1")


def all_fields() -> set[tuple[str, str]]:
    """(kind, field) of every version in the table."""
    out = {(kind, field) for v in VERSIONS for kind, names in available(v).items() for field in names}
    out |= {("Humanoid", f) for f in TABLE["VRML97_1_1"]["Humanoid"]}
    return out


@pytest.mark.parametrize(("kind", "field"), sorted(all_fields()))
def test_every_field_has_its_place(kind: str, field: str) -> None:
    """Mapped to an attribute that exists, or listed with a reason why it holds nothing."""
    attribute = {m.field: m.attribute for m in MEMBERS[kind]} | APART[kind]
    if field in attribute:
        holder = CLASSES[kind]
        assert attribute[field] in {f.name for f in fields(holder)} or hasattr(holder, attribute[field])
    else:
        assert len(WITHOUT_VALUE[field]) > 10


def test_defaults_are_those_of_the_standard() -> None:
    """What `MEMBERS` takes for the default is what the 4.1 table says, and what a new object has."""
    for kind, members in MEMBERS.items():
        new = CLASSES[kind](*(["x"] if kind not in {"Humanoid", "Motion"} else [])) if kind != "Motion" else None
        new = new or MotionData("x", [], [], np.zeros((0, 0)))
        table = {e["name"]: e["default"] for e in TABLE["X3D_4_x_py"][f"HAnim{kind}"]}
        for m in members:
            assert alike(getattr(new, m.attribute), m.default), (kind, m.field)
            assert alike(table[m.field], m.default), (kind, m.field)


def write(scene: Scene) -> Scene:
    """Through the text of its own encoding."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if scene.encoding == "x3d":
            return parse_x3d(print_x3d(scene)[0].encode(), "t.x3d")
        return parse_vrml(print_vrml(scene, scene.encoding)[0].encode(), f"t.{scene.encoding}")


def one(scene: Scene) -> Humanoid:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return humanoids(scene)[0]


OTHER = {
    "SFVec3f": lambda k: np.array([0.25, 0.5 + k, 2.0]),
    "SFRotation": lambda k: np.array([0.0, 1.0, 0.0, 0.5 + k / 16]),
    "SFFloat": lambda k: 1.5 + k,
    "SFTime": lambda k: 2.5 + k,
    "SFInt32": lambda k: 3 + k,
    "SFString": lambda k: f'word {k} "quoted"',
    "MFBool": lambda k: [True, False],
}


def changed(member: object, k: int = 0) -> object:
    """A value that is not the default."""
    kind, default = member.type, member.default  # type: ignore[attr-defined]
    return (not default) if kind == "SFBool" else OTHER[kind](k)


def full() -> Humanoid:
    """A figure in which no field has its default."""
    h = typed(1)
    h.motions = [MotionData("nod", ["vl5"], [("Xrotation", "Yrotation")], np.arange(12.0).reshape(6, 2), end_frame=4)]
    h.tracks = []
    h.poses = [Pose("sit", joints=[Joint("l_knee", rotation=np.array([1.0, 0, 0, 1.5]))])]
    h.skin_displacers = [Displacer("belly_config", np.array([3], np.int32), np.array([[0, 0, 0.25]]))]
    h.skin_normal = np.tile([0.0, 0.0, 1.0], (len(h.skin_coord), 1))
    joint = h.joint("l_shoulder")
    joint.segments[0].coord = np.eye(3)
    joint.segments[0].displacers = [Displacer("muscle_action", np.array([1], np.int32), np.full((1, 3), 0.5))]
    joint.segments[0].moments_of_inertia = np.diag([1.0, 2.0, 2.5]).reshape(9)
    site = joint.segments[0].sites
    site.append(Site("cam_view", viewpoints=[Viewpoint("over the shoulder", np.array([0, 0.25, -1.0]))]))
    light = Node("PointLight", fields={"intensity": 0.5})
    site[0].children = [light]
    for thing, kind in ((h, "Humanoid"), (joint, "Joint"), (joint.segments[0], "Segment"), (site[0], "Site"),
                        (h.displacers()[1], "Displacer"), (h.motions[0], "Motion"), (h.poses[0], "Pose")):  # fmt: skip
        for k, m in enumerate(MEMBERS[kind]):
            setattr(thing, m.attribute, changed(m, k))
        thing.metadata = Node("MetadataString", fields={"name": f"about {kind}", "value": ["yes"]})
    h.motions[0].frame_increment = 2
    return h


def named(h: Humanoid) -> dict[str, object]:
    joint = h.joint("l_shoulder")
    found = {"Humanoid": h, "Joint": joint, "Segment": joint.segments[0], "Site": joint.segments[0].sites[0]}
    found["Displacer"] = next((d for d in h.displacers() if d.name == "blink_action"), None)
    found["Motion"] = h.motions[0] if h.motions else None
    found["Pose"] = h.poses[0] if h.poses else None
    return found


def equal(member: Member, a: object, b: object) -> bool:
    """The same but for float32."""
    return np.allclose(a, b, atol=1e-6) if member.type.startswith(("SFV", "SFR")) else alike(a, b)  # type: ignore[arg-type]


@pytest.mark.parametrize("version", VERSIONS)
def test_written_afresh_and_read_again(version: str) -> None:
    """Every plain field survives where the version has it; otherwise it is in the list of what is lost."""
    encoding = {"200x": "wrl", "1.1": "wrl"}.get(version, "x3d")
    h = full()
    scene, lost = scene_of(
        [h], version="2.0" if version == DRAFT else version, encoding=encoding, draft=version == DRAFT
    )
    back = named(one(write(scene)))
    for kind, thing in named(h).items():
        if kind not in available(version) or back[kind] is None:
            assert kind in {"Motion", "Pose", "Displacer"}
            assert any(kind in line or kind.lower() in line for line in lost), (kind, lost)
            continue
        for m in MEMBERS[kind]:
            if has(version, kind, m.field):
                expected, found = getattr(thing, m.attribute), getattr(back[kind], m.attribute)
                assert equal(m, expected, found), (kind, m.field, expected, found)
            else:
                assert any(f"{kind}.{m.field} " in line for line in lost), (kind, m.field, lost)
        if encoding == "x3d":
            assert back[kind].metadata is not None, kind
    if encoding == "x3d":
        assert back["Segment"].coord.tolist() == np.eye(3).tolist()
        assert [d.name for d in back["Segment"].displacers] == ["muscle_action"]
        assert back["Site"].children[0].type == "PointLight"
        (camera,) = back["Segment"].sites[0].viewpoints
        assert (camera.description, camera.position.tolist()) == ("over the shoulder", [0, 0.25, -1])
        assert len(back["Humanoid"].skin_normal) == len(h.skin_normal)
    if version == DRAFT:
        assert back["Pose"].joints[0].rotation.tolist() == [1, 0, 0, 1.5]
        assert [d.name for d in back["Humanoid"].skin_displacers] == ["belly_config"]
    elif version == "2.0":
        assert any("Humanoid.poses" in line for line in lost) and any("Humanoid.displacers" in line for line in lost)


def test_changed_in_the_files_own_graph() -> None:
    """Every plain field of every kind can be edited; nothing else of the file changes, a second save changes nothing."""
    scene, _ = scene_of([full()], draft=True)
    scene = write(scene)
    scene.body.append(Node("Sound", "Loud", {"intensity": 0.5}))
    h = one(scene)
    for kind, thing in named(h).items():
        for k, m in enumerate(MEMBERS[kind]):
            value = changed(m, k + 1) if m.type not in {"SFBool", "MFBool"} else not m.default
            setattr(thing, m.attribute, [False] if m.type == "MFBool" else value)
        thing.metadata = None
    h.joint("l_shoulder").segments[0].coord[0] = [9, 9, 9]
    h.skin_normal[0] = [1, 0, 0]
    h.poses[0].joints[0].rotation = np.array([0.0, 0, 1, 0.25])
    h.joint("l_shoulder").segments[0].sites[0].viewpoints[0].field_of_view = 0.5
    again, lost = scene_of([h], encoding="x3d")
    assert again is scene and lost == []
    assert any(n.type == "Sound" for n in again.walk())
    text = print_x3d(again)[0]
    back = one(parse_x3d(text.encode()))
    for kind, thing in named(h).items():
        for m in MEMBERS[kind]:
            assert equal(m, getattr(thing, m.attribute), getattr(named(back)[kind], m.attribute)), (kind, m.field)
        assert named(back)[kind].metadata is None
    assert back.joint("l_shoulder").segments[0].coord[0].tolist() == [9, 9, 9]
    assert back.skin_normal[0].tolist() == [1, 0, 0]
    assert back.poses[0].joints[0].rotation.tolist() == [0, 0, 1, 0.25]
    assert back.joint("l_shoulder").segments[0].sites[0].viewpoints[0].field_of_view == 0.5
    assert print_x3d(scene_of([h], encoding="x3d")[0])[0] == text


def test_binding_stays_in_the_file_and_is_never_made() -> None:
    text = print_x3d(good())[0].replace(
        "version='2.0' ", 'version="2.0" jointBindingPositions="0 0 0 0 0.5 0 0 0 0 0 0 0" ', 1
    )
    assert "jointBindingPositions" in text
    h = one(parse_x3d(text.encode()))
    assert h.binding["vl5"][0].tolist() == [0, 0.5, 0]
    assert print_x3d(scene_of([h])[0])[0] == print_x3d(parse_x3d(text.encode()))[0]
    h.binding["vl5"][0][1] = 0.75
    kept, _ = scene_of([h])
    assert one(write(kept)).binding["vl5"][0].tolist() == [0, 0.75, 0]
    fresh, lost = scene_of([h], version="2.0")
    assert "jointBinding" not in print_x3d(fresh)[0] and any("binding" in line for line in lost)


ROBOT = """#VRML V2.0 utf8
PROTO Joint [ exposedField SFString name "" exposedField SFVec3f center 0 0 0 exposedField MFNode children [ ]
  exposedField SFString jointType "" exposedField SFInt32 jointId -1 exposedField SFVec3f jointAxis 0 0 1
  exposedField MFFloat llimit [ ] exposedField MFFloat ulimit [ ] exposedField MFFloat uvlimit [ ]
  exposedField SFFloat gearRatio 1 ] { Transform { children IS children } }
PROTO Segment [ exposedField SFString name "" exposedField MFNode children [ ] ] { Group { children IS children } }
PROTO Humanoid [ exposedField SFString name "" exposedField MFNode humanoidBody [ ] exposedField MFNode joints [ ] ]
{ Group { children IS humanoidBody } }
DEF Bot Humanoid { name "bot" humanoidBody [ DEF WAIST Joint { name "WAIST" jointType "free" jointId 0 children [
  DEF KNEE Joint { name "KNEE" jointType "rotate" jointId 1 jointAxis 0 1 0 uvlimit [ 2.5 3 ] gearRatio 51.2 }
  DEF BODY Segment { name "BODY" } ] } ] joints [ USE WAIST USE KNEE ] }
"""


def test_extras_of_robots() -> None:
    """Read with their types, edited in place, declared in the prototypes of a new VRML97 file, lost in X3D."""
    h = one(parse_vrml(ROBOT.encode(), "bot.wrl"))
    knee = h.joint("KNEE")
    assert knee.extras["jointType"] == "rotate" and knee.extras["jointId"] == 1
    assert knee.extras["jointAxis"].tolist() == [0, 1, 0] and knee.extras["uvlimit"].tolist() == [2.5, 3]
    knee.extras["gearRatio"] = 40.0
    kept, lost = scene_of([h], encoding="wrl")
    assert kept is h.scene and lost == []
    assert one(write(kept)).joint("KNEE").extras["gearRatio"] == 40
    fresh, _ = scene_of([h], version="200x", encoding="wrl")
    back = one(write(fresh))
    assert {f: np.asarray(v).tolist() for f, v in back.joint("KNEE").extras.items()} == {
        f: np.asarray(v).tolist() for f, v in knee.extras.items()
    }
    _, lost = scene_of([h], version="2.0")
    assert any("Joint.jointAxis of 1 object" in line for line in lost)


def test_info_strings_keep_order_and_words() -> None:
    given = '"Made by hand" "authorName=A" "authorName=B" "odd = spaced" "empty=" "height=1.7"'
    text = print_x3d(good())[0].replace('"gender=none" "height=1.7"', given)
    h = one(parse_x3d(text.encode()))
    assert h.info["authorName"] == "B" and h.info["odd"] == "spaced" and h.info["Made by hand"] == ""
    h.info["height"] = "1.8"
    h.info["weight"] = "70"
    del h.info["Made by hand"]
    for scene in (scene_of([h])[0], scene_of([h], version="2.0")[0]):
        strings = one(write(scene)).info_given
        assert strings == ("authorName=A", "authorName=B", "odd = spaced", "empty=", "height=1.8", "weight=70")


def test_names_of_definitions() -> None:
    """DEFs get the standard's prefixes and suffixes, also where the name has none."""
    h = typed(1, skin=False)
    segment = h.joint("l_shoulder").segments[0]
    segment.sites.append(Site("l_acromion"))
    moves = np.full((1, 3), 0.01)
    segment.displacers = [
        Displacer("biceps", np.zeros(1, np.int32), moves),
        Displacer("spot", np.zeros(1, np.int32), moves * 0),
    ]
    defs = scene_of([h])[0].defs()
    assert {"hanim_Ada", "hanim_l_shoulder", "hanim_l_upperarm", "hanim_l_upperarm_coords", "hanim_l_acromion_pt",
            "hanim_biceps_action", "hanim_spot_feature", "hanim_skull_vertex_tip"} <= set(defs)  # fmt: skip


def test_several_humanoids_in_one_file(tmp_path: Path) -> None:
    """Written together, DEFs unique with the humanoid's name before them; read, picked by name, edited in place."""
    import vitruvian as vt

    ada, bob = typed(1), typed(1, skin=False)
    bob.name = "Bob"
    bob.skeleton[0].joints.clear()
    bob.tracks = bob.tracks[1:]
    vt.save([ada, bob], tmp_path / "two.x3d")
    assert [h.name for h in vt.humanoids(tmp_path / "two.x3d")] == ["Ada", "Bob"]
    second = vt.load(tmp_path / "two.x3d", name="Bob")
    assert len(second.joints()) == 1
    assert second.node is not None and second.node.name == "Bob_Bob"
    assert {"Ada_l_shoulder", "Ada_humanoid_root", "Bob_humanoid_root"} <= set(second.scene.defs())
    both = vt.humanoids(tmp_path / "two.x3d")
    both[1].info["age"] = "7"
    both[0].joint("l_hip").rotation[3] = 0.5
    vt.save(both, tmp_path / "edited.x3d")
    back = vt.humanoids(tmp_path / "edited.x3d")
    assert back[1].info["age"] == "7" and back[0].joint("l_hip").rotation[3] == 0.5
    ada.name = bob.name = "Eve"
    vt.save([ada, bob], tmp_path / "twins.wrl")
    twins = vt.humanoids(tmp_path / "twins.wrl")
    assert [h.name for h in twins] == ["Eve", "Eve_2"]
    assert [len(h.joints()) for h in twins] == [18, 1]
    with pytest.raises(VitruvianError, match="expected at least one"):
        vt.save([], tmp_path / "none.x3d")


def test_lights_and_cameras_of_ours_are_not_lost_but_made_anew(tmp_path: Path) -> None:
    import vitruvian as vt

    vt.save(typed(1), tmp_path / "one.x3d")
    assert vt.save(vt.segment(vt.load(tmp_path / "one.x3d")), tmp_path / "two.x3d", hanim="1.0")["lost"] == []
    text = (tmp_path / "one.x3d").read_text()
    other = "<Viewpoint description='Front' fieldOfView='x'/><DirectionalLight direction='1 0'/><SpotLight/>"
    (tmp_path / "own.x3d").write_text(text.replace("<Viewpoint", other + "<Viewpoint", 1))
    lost = vt.save(vt.load(tmp_path / "own.x3d"), tmp_path / "two.x3d", hanim="1.0")["lost"]
    assert lost == ["other nodes of the source file: 1 Viewpoint, 1 DirectionalLight, 1 SpotLight"]


def test_added_and_removed_objects_stay_in_the_files_graph(tmp_path: Path) -> None:
    scene = good()
    scene.body.append(Node("Sound", "Loud", {"intensity": 0.5}))
    h = one(scene)
    sacrum = h.segments()[0]
    sacrum.sites.append(Site("crotch_pt", translation=np.array([0, 0.75, 0])))
    sacrum.coord = sacrum.shapes[0].points
    sacrum.displacers.append(Displacer("dent_action", np.array([2], np.int32), np.full((1, 3), 0.5)))
    h.joint("l_elbow").joints.append(Joint("l_radiocarpal", segments=[Segment("l_carpal", mass=0.5)]))
    moved = h.joint("l_shoulder")
    h.joint("vl5").joints.remove(moved)
    h.joint("humanoid_root").joints.append(moved)
    again, lost = scene_of([h])
    assert again is scene and lost == []
    back = one(write(again))
    assert any(n.type == "Sound" for n in again.walk())
    assert [s.name for s in back.segments()[0].sites] == ["navel_pt", "crotch_pt"]
    assert [d.name for d in back.segments()[0].displacers] == ["dent_action"]
    assert back.joint("l_radiocarpal").segments[0].mass == 0.5
    assert [j.name for j in back.joint("humanoid_root").joints] == ["vl5", "l_shoulder"]
    assert len(back.node.children("joints")) == 5 and len(back.node.children("sites")) == 2
    back.joint("humanoid_root").joints.remove(back.joint("l_shoulder"))
    again, lost = scene_of([back])
    assert lost == [] and again is back.scene
    last = one(write(again))
    assert [j.name for j in last.joints()] == ["humanoid_root", "vl5"]
    assert len(last.node.children("joints")) == 2 and [r.to_node for r in again.routes()] == ["Turn"]


def test_poses_are_read_from_where_browsers_want_them() -> None:
    pose = (
        '<HAnimPose DEF="hanim_Sit" containerField="children" transitionDuration="2" loa="1">'
        '<HAnimJoint name="l_elbow" rotation="1 0 0 -1"/></HAnimPose></HAnimHumanoid>'
    )
    text = print_x3d(good())[0].replace("</HAnimHumanoid>", pose).replace("version='4.0'", "version='4.1'")
    h = one(parse_x3d(text.encode()))
    (sit,) = h.poses
    assert (sit.name, sit.transition_duration, sit.loa) == ("Sit", 2.0, 1)
    assert sit.joints[0].rotation.tolist() == [1, 0, 0, -1]
    assert [j.name for j in h.joints()] == ["humanoid_root", "vl5", "l_shoulder", "l_elbow"]


def test_motion_fields() -> None:
    motion = MOTION.replace(
        'loop="true"', 'loop="true" startFrame="1" frameIncrement="-1" loa="2" channelsEnabled="true false"'
    )
    text = print_x3d(good())[0].replace("</HAnimHumanoid>", motion)
    (m,) = one(parse_x3d(text.encode())).motions
    assert (m.start_frame, m.end_frame, m.frame_increment, m.loa, m.channels_enabled) == (1, 0, -1, 2, [True, False])


def test_model_has_no_field_outside_the_table() -> None:
    """An attribute of the typed objects is a field of the standard or is listed here."""
    ours = {"node", "extras", "scene", "made_from", "info_given", "tracks", "segments", "sites", "shapes", "viewpoints"}
    ours.add("contours")  # DefBody prototypes in a Segment's children
    for kind, holder in CLASSES.items():
        known = {m.attribute for m in MEMBERS[kind]} | set(APART[kind].values()) | ours
        assert {f.name for f in fields(holder)} <= known, kind
    assert issubclass(model.Site, model.Bounded)
