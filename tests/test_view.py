"""Humanoids as the typed view reads them from a scene graph."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from scene_figure import GOOD, MOTION, VRML, broken, good
from vitruvian.errors import FileError, VitruvianWarning
from vitruvian.formats.vrml import parse_vrml, read_vrml
from vitruvian.formats.x3d import parse_x3d, read_x3d
from vitruvian.hanim.graph import Literal, Node, Scene
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.hanim.view import humanoids

# joints, segments, sites with viewpoints, displacers, weighted joints, skin points, motions, tracks
COUNTS = {
    "DiamondManLOA0.x3d": (2, 1, 1, 0, 0, 0, 0, 0),
    "DiamondManLOA2.x3d": (50, 50, 65, 0, 0, 0, 0, 0),
    "HAnim1SpecificationLOA3Invisible.x3d": (94, 94, 109, 0, 0, 0, 0, 0),
    "HAnim2SpecificationLOA3Illustrated.x3d": (94, 94, 109, 0, 0, 0, 0, 0),
    "HAnimModelHandLeft.x3d": (25, 24, 0, 0, 0, 0, 0, 0),
    "Humanoid1NoSegSite.x3d": (18, 0, 0, 0, 18, 390, 0, 0),
    "JinLOA1.x3d": (18, 18, 0, 0, 0, 0, 0, 0),
    "JinLOA3.x3d": (94, 94, 0, 0, 0, 0, 0, 0),
    "JinNoAnimations_Fixed.x3d": (146, 146, 124, 0, 146, 2179, 0, 0),
    "JinScaledV2L1LOA4Humanoid.x3d": (146, 146, 124, 0, 0, 0, 0, 0),
    "JoeKick.x3d": (94, 1, 1, 1, 69, 390, 0, 96),
    "KoreanCharacterMotionAnnexD01Jin.x3d": (18, 18, 0, 0, 0, 0, 1, 0),
    "JoeHAnimKick1a.x3dv": (89, 0, 1, 0, 69, 390, 0, 18),
    "NancyPrototypes.wrl": (17, 16, 0, 0, 0, 0, 0, 72),
    "hanim_transforms.x3dv": (1, 1, 1, 0, 0, 0, 0, 3),
    "sample1.wrl": (30, 30, 0, 0, 0, 0, 0, 0),
}
SEGMENT_POINTS = {"JinLOA1.x3d": 1246, "JinLOA3.x3d": 4009, "KoreanCharacterMotionAnnexD01Jin.x3d": 1246}


def load(path: Path, **options: bool) -> list[Humanoid]:
    read = read_x3d if path.suffix == ".x3d" else read_vrml
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return humanoids(read(path), **options)


def one(scene: Scene, **options: bool) -> Humanoid:
    """The only humanoid; any warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (h,) = humanoids(scene, **options)
    return h


@pytest.mark.parametrize("name", COUNTS)
def test_counts_of_real_files(shared: Path, name: str) -> None:
    (h,) = load(shared / "data" / "hanim" / name)
    sites = {id(s) for s in [*h.all_sites(), *h.viewpoints]}
    found = (
        len(h.joints()),
        len(h.segments()),
        len(sites),
        len(h.displacers()),
        sum(len(j.skin_coord_index) > 0 for j in h.joints()),
        len(h.skin_coord),
        len(h.motions),
        len(h.tracks),
    )
    assert found == COUNTS[name]
    assert len({j.name for j in h.joints()}) == len(h.joints())
    if name in SEGMENT_POINTS:
        shapes = [s for g in h.segments() for s in g.shapes]
        assert sum(len(s.points) for s in shapes if s.points is not None) == SEGMENT_POINTS[name]


def test_file_without_instance_has_no_humanoid(shared: Path) -> None:
    assert load(shared / "data" / "hanim" / "HAnimPrototypes.x3d") == []


def test_real_skin_weights(shared: Path) -> None:
    (h,) = load(shared / "data" / "hanim" / "JinNoAnimations_Fixed.x3d")
    total = np.zeros(len(h.skin_coord))
    for j in h.joints():
        np.add.at(total, j.skin_coord_index, j.skin_coord_weight)
    assert 0.99998 < total.min() <= total.max() < 1.00002
    assert h.skin[0].points is None
    assert h.skin[0].triangles.shape == (4228, 3)
    assert h.skin[0].uv is not None


def test_real_motion(shared: Path) -> None:
    (h,) = load(shared / "data" / "hanim" / "KoreanCharacterMotionAnnexD01Jin.x3d")
    m = h.motions[0]
    assert m.values.shape == (392, 57)
    assert len(m.joints) == len(m.channels) == 18
    assert m.joints.count("IGNORED") == 3
    assert m.channels[0] == ("Xposition", "Yposition", "Zposition", "Zrotation", "Xrotation", "Yrotation")
    assert not m.enabled


def test_clips_of_nancy(shared: Path) -> None:
    (h,) = load(shared / "data" / "hanim" / "NancyPrototypes.wrl")
    assert {t.timer for t in h.tracks} == {"Stand_Time", "Walk_Time", "Run_Time", "Jump_Time"}
    assert {t.field for t in h.tracks} == {"rotation", "translation"}
    assert h.version == "1.1"


def test_good_figure() -> None:
    h = one(good())
    assert (h.name, h.version, h.loa, h.info) == ("Tin", "2.0", -1, {"gender": "none", "height": "1.7"})
    assert [j.name for j in h.joints()] == ["humanoid_root", "vl5", "l_shoulder", "l_elbow"]
    np.testing.assert_array_equal(h.joint("l_elbow").center, [0.2, 1.1, 0])
    np.testing.assert_array_equal(h.joint("vl5").llimit, [-1, -1, -1])
    np.testing.assert_array_equal(h.skin[0].triangles, [[0, 1, 2], [2, 3, 4], [4, 5, 6], [4, 6, 7]])
    (segment,) = h.segments()
    assert segment.mass == 3
    assert segment.shapes[0].material.color == (1, 0, 0)
    assert segment.shapes[0].material.opacity == 0.75
    (track,) = h.tracks
    assert (track.target, track.field, track.interval, track.loop, track.timer) == (
        "l_shoulder",
        "rotation",
        2.0,
        True,
        "Clock",
    )
    np.testing.assert_array_equal(track.keys, [0, 0.5, 1])
    np.testing.assert_array_equal(track.values[1], [0, 0, 1, 1])


@pytest.mark.parametrize(
    ("old", "new", "message", "index", "weight"),
    [
        ('"1 0.5 0.5"', '"1 0.5"', "l_shoulder: 2 weights for 3 indices: the last", [4, 5, 6], [1, 0.5, 0.5]),
        ('"1 0.5 0.5"', '"1 0.5 0.5 9"', "4 weights for 3 indices: weights beyond", [4, 5, 6], [1, 0.5, 0.5]),
        ('"1 0.5 0.5"', '""', "0 weights for 3 indices: the joint moves no skin", [], []),
    ],
)
def test_s01_weights_that_do_not_fit(old: str, new: str, message: str, index: list, weight: list) -> None:
    with pytest.warns(VitruvianWarning, match=message) as said:
        (h,) = humanoids(broken(old, new))
    assert len(said) == 1
    np.testing.assert_array_equal(h.joint("l_shoulder").skin_coord_index, index)
    np.testing.assert_array_equal(h.joint("l_shoulder").skin_coord_weight, weight)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '<HAnimJoint USE="hanim_vl5" containerField="joints"/>\n',
            "",
            "1 joints of the skeleton are not in joints .vl5",
        ),
        (
            '<HAnimJoint USE="hanim_vl5" containerField="joints"/>',
            '<HAnimJoint USE="hanim_vl5" containerField="joints"/>' * 2,
            "1 joints are listed twice",
        ),
        (
            '<HAnimSite USE="hanim_navel_pt" containerField="sites"/>',
            '<HAnimJoint DEF="copy" name="l_wrist" containerField="joints"/>',
            "1 entries of joints are not in the skeleton",
        ),
        (
            '<HAnimSite USE="hanim_navel_pt" containerField="sites"/>',
            '<HAnimJoint USE="hanim_humanoid_root" containerField="skeleton"/>',
            "joint humanoid_root stands twice in skeleton",
        ),
        ('name="vl5" ', "", "joint without a name is called vl5"),
        (' containerField="skeleton"', "", "HAnimJoint hanim_humanoid_root without containerField is read as skeleton"),
    ],
)
def test_defects_that_browsers_live_with(old: str, new: str, message: str) -> None:
    with pytest.warns(VitruvianWarning, match=message) as said:
        (h,) = humanoids(broken(old, new))
    assert len(said) == 1
    assert "tin.x3d:" in str(said[0].message)
    assert [j.name for j in h.joints()] == ["humanoid_root", "vl5", "l_shoulder", "l_elbow"]
    assert [len(j.skin_coord_index) for j in h.joints()] == [2, 2, 3, 3]


def test_m04_copied_skin_coord() -> None:
    coordinate = "0 0.8 0 0.1 0.8 0 0.1 1 0 0 1 0 0.2 1.4 0 0.3 1.4 0 0.3 1.1 0 0.2 1.1 0"
    scene = broken(
        '<Coordinate USE="hanim_skin_coords" containerField="skinCoord"/>',
        f'<Coordinate point="{coordinate}" containerField="skinCoord"/>',
    )
    with pytest.warns(VitruvianWarning, match="copy of the skin geometry's Coordinate"):
        (h,) = humanoids(scene)
    assert h.skin[0].points is None
    scene = broken('<Coordinate USE="hanim_skin_coords" containerField="skinCoord"/>', "")
    with pytest.warns(VitruvianWarning, match="skinCoord is missing"):
        (h,) = humanoids(scene)
    assert h.skin[0].points is None
    assert len(h.skin_coord) == 8


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"4 5 6"', '"4 5 66"', r"joint l_shoulder skinCoordIndex: expected indices in 0..7, found 66 at entry 2"),
        ('"4 5 6"', '"4 -5 6"', "found -5 at entry 1"),
        ("0.2 1.4 0 0.3", "0.2 nan 0 0.3", "finite"),
        ('center="0 1 0"', 'center="0 inf 0"', "finite"),
        ('center="0 1 0"', 'center="0 1"', "3 numbers"),
        ('"1 0.5 0.5"', '"1 -0.5 0.5"', "expected weights of 0 or more, found -0.5 at entry 1"),
        ("4 5 6 7 -1", "4 5 6 8 -1", "expected indices in 0..7, found 8 at entry 11"),
        ('key="0 0.5 1"', 'key="0 1"', "expected 2 key values, one per key, found 3"),
        ('0.2 1.1 0"/>', '0.2 1.1"/>', "groups of 3"),
    ],
)
def test_what_is_refused(old: str, new: str, message: str) -> None:
    scene = broken(old, new)
    with pytest.raises(FileError, match=message) as error:
        humanoids(scene)
    assert error.value.path == "tin.x3d"
    element = GOOD.rindex("<", 0, GOOD.index(old))
    assert error.value.line == GOOD[:element].count("\n") + 1
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        (h,) = humanoids(scene, repair=True)
    assert any("repaired" in str(w.message) for w in said)
    assert len(h.joints()) == 4
    assert np.isfinite(h.skin_coord).all()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        (again,) = humanoids(scene)  # the repair went into the graph, so that it will be written
    assert [list(j.skin_coord_index) for j in again.joints()] == [list(j.skin_coord_index) for j in h.joints()]


def test_displacers_are_checked() -> None:
    ok = (
        '<HAnimDisplacer DEF="d" name="bulge_action" coordIndex="5 6" displacements="0 0 1 0 0 2" weight="0.5"/>'
        "\n</HAnimJoint></HAnimJoint></HAnimJoint>"
    )
    h = one(broken("</HAnimJoint></HAnimJoint></HAnimJoint>", ok))
    (d,) = h.joint("l_shoulder").displacers
    assert (d.name, list(d.coord_index), d.weight) == ("bulge_action", [5, 6], 0.5)
    np.testing.assert_array_equal(d.displacements, [[0, 0, 1], [0, 0, 2]])
    for old, new, message in (('"5 6"', '"5 60"', "found 60"), ('"5 6"', '"5 6 7"', "expected 3 displacements")):
        with pytest.raises(FileError, match=message):
            humanoids(broken("</HAnimJoint></HAnimJoint></HAnimJoint>", ok.replace(old, new)))


def test_prototype_humanoid() -> None:
    h = one(parse_vrml(VRML.encode(), "nobody.wrl"))
    assert (h.name, h.version) == ("nobody", "1.1")
    assert [j.name for j in h.joints()] == ["HumanoidRoot", "l_hip"]
    np.testing.assert_array_equal(h.joint("l_hip").rotation, [1, 0, 0, 0.5])
    (segment,) = h.segments()
    assert segment.mass == 7  # the prototype's default
    (shape,) = segment.shapes
    assert shape.points is not None
    assert shape.transform is not None
    np.testing.assert_allclose(shape.transform, [[2, 0, 0, 0], [0, 2, 0, 1], [0, 0, 2, 0], [0, 0, 0, 1]], atol=1e-15)
    assert shape.triangles.shape == (12, 3)


def test_several_humanoids() -> None:
    two = VRML + VRML[VRML.index("DEF Nobody") :].replace("nobody_", "other_").replace("DEF Nobody", "DEF Other")
    with pytest.warns(VitruvianWarning, match="given twice"):
        a, b = humanoids(parse_vrml(two.encode(), "two.wrl"))
    assert (a.name, b.name) == ("nobody", "nobody_2")
    assert [len(h.joints()) for h in (a, b)] == [2, 2]
    assert a.joints()[0].node is not b.joints()[0].node


def test_a_given_name_beats_one_from_a_def() -> None:
    scene = parse_x3d(
        (b'<X3D version="4.0"><Scene><HAnimHumanoid name="x"><HAnimJoint name="humanoid_root" DEF="r" '
         b'containerField="skeleton"><HAnimJoint DEF="hanim_l_hip"><HAnimJoint DEF="q" name="l_hip"/></HAnimJoint>'
         b'</HAnimJoint><HAnimJoint USE="r" containerField="joints"/><HAnimJoint USE="hanim_l_hip" '
         b'containerField="joints"/><HAnimJoint USE="q" containerField="joints"/></HAnimHumanoid></Scene></X3D>'),
        "x.x3d",
    )  # fmt: skip
    with pytest.warns(VitruvianWarning):
        (h,) = humanoids(scene)
    assert [j.name for j in h.joints()] == ["humanoid_root", "l_hip_2", "l_hip"]
    assert h.joint("l_hip").node.name == "q"


def test_units_are_applied() -> None:
    scene = good()
    scene.units = [("length", "cm", 0.01), ("angle", "degree", np.pi / 180)]
    h = one(scene)
    np.testing.assert_allclose(h.joint("l_elbow").center, [0.002, 0.011, 0])
    np.testing.assert_allclose(h.skin_coord[1], [0.001, 0.008, 0])
    np.testing.assert_allclose(h.joint("vl5").ulimit, np.full(3, np.pi / 180))
    np.testing.assert_allclose(h.tracks[0].values[1], [0, 0, 1, np.pi / 180])


def test_axes_become_unit_vectors() -> None:
    h = one(broken('center="0 1 0"', 'center="0 1 0" rotation="0 3 4 1.5"'))
    np.testing.assert_allclose(h.joint("vl5").rotation, [0, 0.6, 0.8, 1.5])
    with pytest.warns(VitruvianWarning, match="axis 0 0 0 means no rotation"):
        (h,) = humanoids(broken('center="0 1 0"', 'center="0 1 0" rotation="0 0 0 1.5"'))
    np.testing.assert_array_equal(h.joint("vl5").rotation, [0, 0, 1, 0])


def test_binding_arrays() -> None:
    scene = broken('loa="-1"', 'loa="-1" jointBindingPositions="0 0 0 0 0.5 0" jointBindingScales="0 0 0"')
    with pytest.warns(VitruvianWarning, match="binding matrices"):
        (h,) = humanoids(scene)
    assert list(h.binding) == ["vl5"]
    np.testing.assert_array_equal(h.binding["vl5"][0], [0, 0.5, 0])
    np.testing.assert_array_equal(h.binding["vl5"][2], [1, 1, 1])


def test_a_chain_between_timer_and_interpolator() -> None:
    old = '<ROUTE fromNode="Clock" fromField="fraction_changed" toNode="Turn" toField="set_fraction"/>'
    ease = '<ScalarInterpolator DEF="Ease" key="0 1" keyValue="0 1"/>'
    ease += old.replace('"Turn"', '"Ease"') + old.replace('"Clock"', '"Ease"').replace(
        "fraction_changed", "value_changed"
    )
    with pytest.warns(VitruvianWarning, match="driven through ScalarInterpolator Ease"):
        (h,) = humanoids(broken(old, ease))
    assert h.tracks[0].timer == "Clock"


def test_a_skeleton_of_any_depth_and_with_cycles() -> None:
    top = Node("HAnimJoint", fields={"name": "humanoid_root"})
    joint = top
    for k in range(5000):
        child = Node("HAnimJoint", fields={"name": f"j{k}"})
        joint.fields["children"] = [child]
        joint = child
    joint.fields["children"] = [top]  # a cycle
    body = Node("HAnimHumanoid", fields={"name": "worm", "skeleton": [top]})
    with pytest.warns(VitruvianWarning) as said:
        (h,) = humanoids(Scene(body=[body]))
    assert any("reached twice" in str(w.message) for w in said)
    assert len(h.joints()) == 5001


JUNK = ["", "1 2 3 4 5 6 7", "nan inf -inf 1e999", "a b c", '"x" "y"', '"', "99999999999999999999", "-7", "1.5", "TRUE"]


@pytest.mark.parametrize("junk", JUNK)
def test_rubbish_is_read_or_refused_with_one_line(junk: str) -> None:
    """Every field filled with rubbish in turn: a humanoid, or a FileError; in repair mode always a humanoid."""
    scene = broken("</HAnimHumanoid>", MOTION)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for node in list(scene.walk()):
            for field, value in list(node.fields.items()):
                if not isinstance(value, Literal):
                    continue
                before = {n: dict(n.fields) for n in scene.walk()}
                node.fields[field] = Literal(junk, "xml", value.line)
                try:
                    humanoids(scene)
                except FileError as error:
                    assert "\n" not in str(error)
                    assert error.line > 0
                (h,) = humanoids(scene, repair=True)
                assert len(h.joints()) == 4
                humanoids(scene)  # what was repaired is repaired in the graph
                for n, fields in before.items():
                    n.fields = fields


def test_text_outside_of_humanoids_is_not_read() -> None:
    scene = broken("<Scene>", '<Scene><Transform translation="a b"><Shape><Box size="x"/></Shape></Transform>')
    assert len(one(scene).joints()) == 4
