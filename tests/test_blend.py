"""Mixtures of people and the space they span: identities, symmetry, wishes met, what is refused."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.errors import VitruvianError, VitruvianWarning
from vitruvian.modeling import source
from vitruvian.modeling.blend import blend, measures_of, worn
from vitruvian.modeling.measures import measures
from vitruvian.modeling.person import person
from vitruvian.modeling.space import space

HAIR = {"hair": "short"}


@pytest.fixture(scope="module")
def people():
    shapes = ({"age": 12}, {"age": 70, "gender": 0.8}, {"weight": 0.05}, {"weight": 0.95, "gender": 0.2})
    return [person(loa=1, **s, **HAIR) for s in shapes]


def places(h):
    sites = [s.translation for s in h.all_sites()]
    return np.concatenate([h.skin_coord, [j.center for j in h.joints()], sites])


def test_one_weight_is_the_person_itself(people):
    found = blend(people, [0, 1, 0, 0])
    assert np.array_equal(places(found), places(people[1]))
    assert found is not people[1] and found.made_from == people[1].made_from


def test_the_middle_is_the_mean_and_does_not_know_the_order(people):
    one, other = blend(people[:2], [0.5, 0.5]), blend(people[1::-1], [0.5, 0.5])
    assert np.abs(places(one) - places(other)).max() < 1e-12
    body = slice(0, source.BODY)  # clothes differ in topology: the leader's are carried
    mean = (people[0].skin_coord[body] + people[1].skin_coord[body]) / 2
    assert np.abs(one.skin_coord[body] - mean).max() < 1e-12
    a, b = ({d.name: d.displacements for d in h.displacers()} for h in (one, other))
    assert len(a) == 76 and all(np.allclose(a[n], b[n]) for n in a)
    heavy = [float(h.info["weight"]) for h in (people[0], one, people[1])]
    assert heavy[0] < heavy[1] < heavy[2]


def frozen(value):
    """All that hangs on a humanoid, as comparable bytes."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, (list, tuple)):
        return tuple(frozen(v) for v in value)
    if isinstance(value, dict):
        return tuple((k, frozen(v)) for k, v in value.items())
    if is_dataclass(value) and not isinstance(value, type):
        return tuple(frozen(getattr(value, f.name)) for f in fields(value) if f.name != "made_from")
    return value


def test_people_stay_as_they_are(people):
    before = [frozen(p) for p in people]
    blend(people, [0.4, 0.3, 0.2, 0.1])
    space(people, ["height", "waist"]).changed(people[0], {"height": 0.02})
    for p, was in zip(people, before, strict=True):
        assert frozen(p) == was


def test_skin_weights_and_texture_places_are_mixed(people):
    one, other = people[0].copied(), people[1]
    weights = one.joint("l_elbow").skin_coord_weight
    low = weights < 0.999
    upper = one.joint("l_shoulder")
    one.joint("l_elbow").skin_coord_weight = np.where(low, weights * 0.5, weights)
    one.skin = [replace(one.skin[0], uv=one.skin[0].uv * 0.5), *one.skin[1:]]
    found = blend([one, other], [0.25, 0.75])
    sums = np.zeros(len(found.skin_coord))
    for j in found.joints():
        assert (j.skin_coord_weight > 0).all() and (np.diff(j.skin_coord_index) > 0).all()
        np.add.at(sums, j.skin_coord_index, j.skin_coord_weight)
    was = np.zeros(len(sums))
    lead = other if len(other.skin_coord) == len(sums) else one
    for j in lead.joints():
        np.add.at(was, j.skin_coord_index, j.skin_coord_weight)
    assert np.abs(sums - was).max() < 1e-9
    a, b = (
        dict(zip(h.joint("l_elbow").skin_coord_index, h.joint("l_elbow").skin_coord_weight)) for h in (other, found)
    )
    common = [v for v in one.joint("l_elbow").skin_coord_index[low] if v in a and v in b and v < source.BODY]
    assert common and all(b[v] <= a[v] + 1e-9 for v in common) and any(b[v] < a[v] - 0.02 for v in common)
    assert np.allclose(found.skin[0].uv, other.skin[0].uv * 0.875) and upper.name == "l_shoulder"


def test_masses_are_those_of_the_volume(people):
    found = blend(people[2:], [0.5, 0.5])
    measured = measures(found)
    assert sum(s.mass for s in found.segments()) == pytest.approx(measured.volume * 1050, rel=0.01)
    assert float(found.info["weight"]) == pytest.approx(measured.mass, abs=0.06)


def test_a_mixture_passes_the_doctor_and_moves(people, tmp_path):
    made = blend(people[:2], [0.5, 0.5])
    vt.save(made, tmp_path / "m.x3d")
    assert not [f for f in vt.check(tmp_path / "m.x3d") if f.severity in ("error", "warning")]
    again = vt.load(tmp_path / "m.x3d")
    assert np.abs(places(again) - places(made)).max() < 1e-5
    assert len(blend([again, people[0]], [0.5, 0.5]).skin_coord)  # files and persons have one topology


def test_hair_that_one_alone_wears_stays_on_the_head():
    bun, short = person(loa=1, gender=0.0, hair="bun"), person(loa=1, age=12, hair="short")
    found = blend([bun, short], [0.6, 0.4])
    hair = next(s for s in found.skin if s.name == "hair")
    top = found.skin_coord[np.unique(hair.triangles)]
    was = bun.skin_coord[np.unique(next(s for s in bun.skin if s.name == "hair").triangles)]
    assert len(found.skin_coord) == len(bun.skin_coord)
    head = found.joint("skullbase").center if found.joint("skullbase") else found.joints()[0].center
    before = bun.joint("skullbase").center if bun.joint("skullbase") else bun.joints()[0].center
    assert np.abs((top - head) - (was - before)).max() < 0.06
    assert "hair" in worn([bun, short], found) and worn([bun, bun], blend([bun, bun], [0.5, 0.5])) == []


def test_an_example_comes_out_at_its_own_measures(people):
    spanned = space(people, ["height", "waist"])
    for p in people:
        own = measures_of(p)
        found = spanned.made({n: own[n] for n in spanned.names})
        assert np.abs(places(found) - places(p)).max() < 1e-9


def test_examples_come_out_of_a_space_of_ten():
    """And measures asked for are met within 2 mm."""
    rng = np.random.default_rng(4)
    many = [
        person(loa=1, age=a, gender=g, weight=w, outfit=None, hair="none")
        for a, g, w in rng.uniform((14, 0, 0.1), (70, 1, 0.9), (10, 3))
    ]
    names = ["height", "chest", "waist", "hips"]
    spanned = space(many, names)
    own = dict(zip(names, spanned.sizes[4], strict=True))
    assert np.abs(places(spanned.made(own)) - places(many[4])).max() < 1e-9
    wish = spanned.sizes.mean(axis=0) + [0.03, -0.01, 0.0, 0.01]
    found = measures_of(spanned.made(dict(zip(names, wish, strict=True))), names)
    assert max(abs(found[n] - want) for n, want in zip(names, wish, strict=True)) < 0.002


def test_what_people_do_not_reach_is_said(people):
    spanned = space(people, ["height", "waist"])
    with pytest.warns(VitruvianWarning) as said:
        found = spanned.made({"height": 2.4, "waist": 0.7})
    words = [str(w.message) for w in said]
    assert any("height: 2.400 m is beyond these people" in w for w in words)
    assert any("height: the nearest that these people reach is" in w for w in words)
    span = np.ptp(spanned.sizes[:, 0])
    assert measures_of(found)["height"] < spanned.sizes[:, 0].max() + 0.7 * span


def test_a_changed_body_keeps_what_is_its_own(people):
    spanned = space(people, ["height", "waist"])
    who = people[0].copied()
    who.skin_coord = who.skin_coord.copy()
    who.skin_coord[3000] += [0, 0, 0.002]
    before = measures_of(who)
    found = spanned.changed(who, {"height": 0.03})
    after = measures_of(found)
    assert after["height"] - before["height"] == pytest.approx(0.03, abs=0.002)
    assert after["waist"] == pytest.approx(before["waist"], abs=0.002)
    plain = spanned.changed(people[0], {"height": 0.03})
    assert np.abs(found.skin_coord[3000] - plain.skin_coord[3000] - [0, 0, 0.002]).max() < 5e-4
    assert np.array_equal(spanned.changed(who, {}).skin_coord, who.skin_coord)


def test_refusals(people):
    with pytest.raises(VitruvianError, match="sum to 1"):
        blend(people[:2], [0.5, 0.6])
    with pytest.raises(VitruvianError, match="one for each of 2"):
        blend(people[:2], [1.0])
    with pytest.raises(VitruvianError, match="two or more"):
        blend(people[:1], [1.0])
    with pytest.raises(VitruvianError, match="finite|sum to 1"):
        blend(people[:2], [np.nan, 1.0])
    coarse = people[0].copied()
    coarse.skin = [replace(coarse.skin[0], triangles=coarse.skin[0].triangles[:, [0, 2, 1]] // 2), *coarse.skin[1:]]
    with pytest.raises(VitruvianError, match="topology of person, found other triangles"):
        blend([people[0], coarse], [0.5, 0.5])
    with pytest.raises(VitruvianError, match="expected a seamless skin"):
        blend([people[0], replace(people[1], skin=[])], [0.5, 0.5])
    with pytest.raises(VitruvianError, match="finite"):
        space(people, ["waist"]).made({"waist": np.nan})
    with pytest.raises(VitruvianError, match="expected the joints of"):
        blend([people[0], person(loa=2)], [0.5, 0.5])
    with pytest.raises(VitruvianError, match="same measures"):
        space([people[0], people[0]], ["waist"])
    with pytest.raises(VitruvianError, match="measure: expected one of"):
        space(people, ["nose"])
    with pytest.warns(VitruvianWarning, match="beyond the examples"):
        blend(people[:2], [-0.6, 1.6])
