"""Hands in the page, run by node, against the kernel: any pose, scaled joints, parameters, missing blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import vitruvian as vt
from test_page_deform import in_page, posed
from vitruvian.body.hands import RANGES, Rounding, store_roundings
from vitruvian.body.rotations import from_axis_angle, to_matrix
from vitruvian.body.types import Body
from vitruvian.deform.deformer import deformer
from vitruvian.deform.hand_links import hands_of
from vitruvian.show.programs import program_blocks

WRISTS = ("l_radiocarpal", "r_radiocarpal")


@pytest.fixture(scope="module")
def humanoid():
    return vt.person(loa=4, outfit="body suit", hair="none")


@pytest.fixture(scope="module")
def body(humanoid) -> Body:
    return vt.pack(humanoid)


def gripping(body: Body, seed: int, most: float = 1.6) -> np.ndarray:
    """Joint matrices with all joints of the hands turned about any axis, a little backwards to far."""
    rng = np.random.default_rng(seed)
    joints = {j for hand in hands_of(body) for j in (*hand.near, *hand.far) if j >= 0}
    names = [j for j in body.skeleton.names if body.skeleton.index[j] in joints and j not in WRISTS]
    turns = {j: [*rng.normal(size=3), rng.uniform(-0.5, most)] for j in names}
    return posed(body, turns | {wrist: [0, 0, 1, 0.4] for wrist in WRISTS})


def differences(tmp_path, cases, some=None) -> list[float]:
    """The largest distance in the page, over vertices, from what the kernel has; for (body, matrices)."""
    more = {} if some is None else {"some": some}
    answers = in_page(tmp_path, [(body, m, ["hand"], None, more) for body, m in cases])
    out = []
    for (body, matrices), answer in zip(cases, answers, strict=True):
        found = answer["hand"]["points"]
        if some is not None:
            np.testing.assert_array_equal(answer["hand"]["some"], found[some])
        out.append(float(np.abs(found - deformer("hand", body)(matrices)).max()))
    return out


def test_any_pose_and_scaled_joints(body, tmp_path) -> None:
    scale = np.ones((len(body.skeleton), 3))
    hand = hands_of(body)[0]
    scale[hand.near[::3]] = np.random.default_rng(3).uniform(0.8, 1.25, (len(hand.near[::3]), 3))
    scaled = replace(body, skeleton=replace(body.skeleton, scale=scale))
    cases = [
        (body, posed(body, {})),
        (body, gripping(body, 0)),
        (body, gripping(body, 1)),
        (scaled, gripping(scaled, 1)),
    ]
    some = [*range(0, 500, 7), *hand.vertices[5::11].tolist()]
    rest, one, two, stretched = differences(tmp_path, cases, some)
    assert max(rest, one, two) < 1e-5
    assert stretched < 1e-4
    assert np.abs(cases[3][1] - cases[2][1]).max() > 0.05


def test_other_parameters_and_simpler_hands(humanoid, body, tmp_path) -> None:
    kept = dict(humanoid.info)
    try:
        sharp = Rounding(0.9, 0.2, 0.4, 0.8, 0.35, arc=0.3)
        store_roundings(humanoid, {"index": sharp, "l_thumb": Rounding(0.1, 0.5, 0.5, 0.1, 0.7, arc=0.0)})
        tuned = vt.pack(humanoid)
    finally:
        humanoid.info = kept
    simple = vt.pack(vt.person(loa=2, outfit="body suit", hair="none"))
    matrices = gripping(body, 2, 1.2)
    cases = [(tuned, matrices), (simple, gripping(simple, 2, 1.2))]
    assert max(differences(tmp_path, cases, [0, 5])) < 1e-5  # a part without hands
    assert np.abs(deformer("hand", tuned)(matrices) - deformer("hand", body)(matrices)).max() > 1e-3


def test_parameters_that_a_slider_sets(body, tmp_path) -> None:
    """Every parameter of every link, axes too, with the second pass and without; and the given ones again."""
    rng = np.random.default_rng(4)
    hands, roundings, low, high = hands_of(body), {}, *np.array(list(RANGES.values()), float).T
    count = sum(len(h.near) for h in hands)
    numbers, tilt = rng.uniform(low, high, (count, len(RANGES))), rng.uniform(-0.7, 0.7, count)
    tilt[::3] = 0
    links = [(h, k) for h in hands for k in range(len(h.near))]
    for (hand, k), own, angle in zip(links, numbers, tilt, strict=True):
        turn = to_matrix(from_axis_angle([*(hand.end - hand.start)[k], angle]))
        axis = tuple((turn @ hand.axis_near[k]).tolist()) if angle else None
        roundings[body.skeleton.names[hand.near[k]]] = Rounding(**dict(zip(RANGES, own.tolist())), axis=axis)
    state = {"rounding": numbers.ravel().tolist(), "tilt": tilt.tolist(), "plain": False}
    given = [getattr(r, name) for h in hands for r in h.roundings for name in RANGES]
    matrices, d = gripping(body, 5), deformer("hand", body)
    cases = [(state, d.tuned(roundings)), (state | {"plain": True}, d.tuned(roundings, rounded=False))]
    cases.append(({"rounding": given, "tilt": [0] * count, "plain": False}, d))
    answers = in_page(
        tmp_path, [(body, matrices, ["hand"], None, {"tuned": t, "some": [*range(0, 9000, 7)]}) for t, _ in cases]
    )
    for answer, (_, wanted) in zip(answers, cases, strict=True):
        assert np.abs(answer["hand"]["points"] - wanted(matrices)).max() < 1e-5
        np.testing.assert_array_equal(answer["hand"]["some"], answer["hand"]["points"][range(0, 9000, 7)])
    assert np.abs(cases[0][1](matrices) - cases[1][1](matrices)).max() > 1e-3


@pytest.mark.parametrize("missing", ["hand_share", "hand_previous", "hand_left"])
def test_a_program_that_lacks_something_is_no_program(body, tmp_path, monkeypatch, missing) -> None:
    blocks = lambda body, actor: [b for b in program_blocks(body, actor) if b.channel != missing]  # noqa: E731
    monkeypatch.setattr("vitruvian.show.actors.program_blocks", blocks)
    cases = [(body, posed(body, {}), ["hand", "log"], None, {"some": [0, 5]})]
    answer = in_page(tmp_path, cases)[0]
    assert answer["hand"] is None
    assert len(answer["log"]["points"]) == len(body.skin.rest)
