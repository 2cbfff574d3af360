"""The compiled kernels: equal to their twins, blind to how influences are written down and to threads."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import skins
from vitruvian.body.types import Body, Skin, Weights
from vitruvian.deform import normals, operators
from vitruvian.deform.deformer import WEIGHTED, deformer
from vitruvian.native import kernels

pytestmark = pytest.mark.skipif(kernels() is None, reason="vitruvian._native is not built: pip install .")


def by_twin(monkeypatch, task):
    with monkeypatch.context() as m:
        m.setattr(operators, "kernels", lambda: None)
        m.setattr(normals, "kernels", lambda: None)
        return task()


@pytest.fixture(params=["base", "v3"])
def instructions(request):
    """Both builds of the kernels, where the processor has both."""
    native = kernels()
    before = native.instruction_set()
    try:
        native.use_instruction_set(request.param)
    except ValueError:
        pytest.skip(f"this processor or build has no {request.param} kernels")
    yield request.param
    native.use_instruction_set(before)


@pytest.mark.parametrize("name", WEIGHTED)
@pytest.mark.parametrize(("influences", "sums"), [*((n, None) for n in (1, 2, 4, 8, 12, 30)), (4, (0.4, 1))])
@pytest.mark.parametrize("angle", [0.2, 1.5])
def test_kernel_equals_twin(name, influences, sums, angle, instructions, monkeypatch):
    body = skins.crowd(influences, sums=sums, seed=influences, joints=max(12, influences))
    m = skins.poses(body, angle=angle)
    d = deformer(name, body)
    twin = by_twin(monkeypatch, lambda: (d(m), d.frames(m)))
    assert np.abs(d(m) - twin[0]).max() < 1.5e-6
    assert np.abs(d.frames(m) - twin[1]).max() < 1.5e-6


@pytest.mark.parametrize("influences", [2, 4, 8])
@pytest.mark.parametrize("angle", [0.05, 0.25, 0.4, 0.6])
def test_log_equals_twin_among_joints_that_are_near_and_far(influences, angle, instructions, monkeypatch):
    """Chains of joints, on both sides of the angle up to which the kernel blends and steps in one go."""
    joint = np.arange(12)
    body = skins.crowd(influences, vertices=500, seed=3)
    rng = np.random.default_rng(5)
    first = np.sort(rng.integers(0, 12 - influences + 1, 500))[:, None] + joint[:influences]
    weight = rng.dirichlet(np.full(influences, 0.7), 500)
    rows = Weights.from_pairs(500, np.repeat(np.arange(500), influences), first.ravel(), weight.ravel())
    body = Body("chain", body.skeleton, Skin(body.skin.rest, body.skin.triangles, rows))
    m = skins.poses(body, angle=angle)
    d = deformer("log", body)
    assert np.abs(d(m) - by_twin(monkeypatch, lambda: d(m))).max() < 1.5e-6


@pytest.mark.parametrize("name", WEIGHTED)
def test_kernel_equals_twin_on_wild_and_scaled_motions(name, monkeypatch):
    body = skins.crowd(6, seed=9)
    for m in (skins.poses(body, angle=3.1), skins.poses(body, angle=1.0, scale=True)):
        d = deformer(name, body)
        twin = by_twin(monkeypatch, lambda d=d, m=m: d(m))
        assert np.abs(d(m) - twin).max() < 1e-5


def test_normals_equal_twin(monkeypatch):
    body = skins.crowd(4)
    d = deformer("linear", body)
    points = d(skins.poses(body))
    assert np.abs(d.normals(points) - by_twin(monkeypatch, lambda: d.normals(points))).max() < 5e-6


@pytest.mark.parametrize("name", WEIGHTED)
def test_threads_batches_and_blocks_do_not_change_a_bit(name):
    body = skins.crowd(6, vertices=1700)
    m = skins.poses(body, frames=3, angle=1.2)
    first = deformer(name, body, threads=1)(m)
    for threads in (2, 3, 7):
        d = deformer(name, body, threads=threads)
        assert np.array_equal(d(m), first)
        assert np.array_equal(d.normals(first), deformer(name, body, threads=1).normals(first))
    assert all(np.array_equal(deformer(name, body)(m[f]), first[f]) for f in range(3))


POOL = """
import os, sys, threading
import numpy as np
sys.path.insert(0, "tests")
import skins
from vitruvian.deform.deformer import deformer

body = skins.crowd(4, vertices=9000)
m = skins.poses(body, frames=1)
d = deformer("linear", body, threads=3)
expected = deformer("linear", body, threads=1)(m)

def same():
    return np.array_equal(d(m), expected)

def many(found):
    found.append(all(same() for _ in range(50)))
"""


@pytest.mark.parametrize(
    "ending",
    [
        "assert all(same() for _ in range(200))",
        # four callers at once: one has the helpers, the others work alone
        "found = []\nrun = [threading.Thread(target=many, args=(found,)) for _ in range(4)]\n"
        "[t.start() for t in run]; [t.join() for t in run]\nassert found == [True] * 4",
        # a child has no helpers but its own
        "assert same()\npid = os.fork()\nif pid == 0: os._exit(0 if same() and same() else 1)\n"
        "assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0\nassert same()",
        # after the helpers have ended
        "import atexit\nassert same()\natexit._run_exitfuncs()\nassert same()",
    ],
    ids=["calls", "callers", "fork", "exit"],
)
def test_helper_threads(ending):
    if "fork" in ending and not hasattr(os, "fork"):
        pytest.skip("this system has no fork")
    root = Path(__file__).resolve().parent.parent
    subprocess.run([sys.executable, "-c", POOL + ending], cwd=root, check=True, timeout=30)


def rewritten(body: Body, pairs) -> Body:
    """The same vertex with other (joint, weight) entries, in that order."""
    joints = np.array([j for j, _ in pairs], np.int32)
    weights = np.array([w for _, w in pairs])
    rows = Weights(np.array([0, len(pairs)], np.int32), joints, weights)
    return Body(body.name, body.skeleton, Skin(body.skin.rest, body.skin.triangles, rows))


influences = st.lists(
    st.tuples(st.integers(0, 11), st.floats(0.02, 1)), min_size=1, max_size=10, unique_by=lambda pair: pair[0]
)


@settings(max_examples=40, deadline=None)
@given(influences, st.randoms(use_true_random=False), st.sampled_from(WEIGHTED), st.integers(0, 100))
def test_the_way_influences_are_written_does_not_matter(pairs, random, name, seed):
    total = sum(w for _, w in pairs)
    pairs = [(j, w / total) for j, w in pairs]
    body = skins.crowd(1, vertices=1)
    m = skins.poses(body, frames=2, angle=0.7, seed=seed)
    expected = deformer(name, rewritten(body, pairs))(m)

    shuffled = random.sample(pairs, len(pairs))
    assert np.array_equal(deformer(name, rewritten(body, shuffled))(m), expected)

    tail = [(j, 0.0) for j in range(12) if j not in {j for j, _ in pairs}][: random.randint(0, 5)]
    assert np.abs(deformer(name, rewritten(body, pairs + tail))(m) - expected).max() < 1e-6

    if name == "volume":  # its centres follow squared weights: two halves carry less than one whole
        return
    # an influence split over two joints that move alike, and merged again
    (j, w), *others = sorted(pairs, key=lambda pair: pair[1])
    free = [f for f in range(12) if f not in {j for j, _ in pairs}]
    twins = m.copy()
    twins[:, free[0]] = m[:, j]
    split = deformer(name, rewritten(body, [(j, w / 2), (free[0], w / 2), *others]))(twins)
    assert np.abs(split - expected).max() < 2e-6


@settings(max_examples=30, deadline=None)
@given(influences, st.sampled_from(WEIGHTED), st.integers(0, 100))
def test_equal_motions_are_exactly_rigid(pairs, name, seed):
    total = sum(w for _, w in pairs)
    body = rewritten(skins.crowd(1, vertices=1), [(j, w / total) for j, w in pairs])
    m = np.tile(skins.poses(body, frames=1, angle=3.0, seed=seed)[:, :1], (1, 12, 1, 1))
    expected = m[0, 0, :3, :3] @ body.skin.rest[0] + m[0, 0, :3, 3]
    assert np.abs(deformer(name, body)(m)[0, 0] - expected).max() < 2e-6


def test_uniform_groups_and_mixed_groups_agree():
    """A vertex moves the same among neighbours with its joints (one path of the kernel) and without (the other)."""
    rng = np.random.default_rng(4)
    many, one = 64, 40
    joint = np.tile([0, 1, 2, 3], (many, 1))
    weight = rng.dirichlet(np.ones(4), many)
    rest = rng.uniform(-1, 1, (many, 3))
    skeleton = skins.skeleton(12, rng.uniform(-1, 1, (12, 3)))
    rows = Weights.from_pairs(many, np.repeat(np.arange(many), 4), joint.ravel(), weight.ravel())
    together = Body("together", skeleton, Skin(rest, np.zeros((0, 3)), rows))
    joint = np.stack([[4, 5, 6, 7], joint[one], [8, 9, 10, 11]])
    rows = Weights.from_pairs(3, np.repeat(np.arange(3), 4), joint.ravel(), np.tile(weight[one], 3))
    alone = Body("alone", skeleton, Skin(np.tile(rest[one], (3, 1)), np.zeros((0, 3)), rows))
    for angle in (0.1, 0.6, 2.0, 3.1):
        m = skins.poses(together, angle=angle)
        for name in ("dual-quaternion", "log", "log-pair", "log-absolute"):
            near, (far,) = (deformer(name, b).operator.buckets for b in (together, alone))
            assert near[0].shared
            assert one in near[0].vertices
            assert not far.shared
            a, b = deformer(name, together)(m)[:, one], deformer(name, alone)(m)[:, 1]
            assert np.abs(a - b).max() < 2e-6


@pytest.mark.parametrize("name", WEIGHTED)
def test_what_is_bound_can_be_sent_elsewhere(name):
    body = skins.crowd(4)
    m = skins.poses(body)
    d = deformer(name, body)
    here = d(m)
    assert np.array_equal(pickle.loads(pickle.dumps(d))(m), here)


def test_touch_reads_and_writes_everything():
    rest, joint = np.ones((2, 3, 8), np.float32), np.zeros((2, 4), np.int32)
    weight, out = np.full((2, 4, 8), 0.25, np.float32), np.zeros((11, 3), np.float32)
    target = np.arange(10)[::-1].astype(np.int32)
    kernels().touch(None, rest, joint, weight, target, 10, out)
    assert (out[:10] == 2).all()
    assert not out[10].any()
    kernels().touch(np.ones((1, 16), np.float32), rest, joint, weight, target, 10, out)
    assert (out[:10] == 18).all()
    assert not out[10].any()


def test_arrays_that_do_not_fit_are_refused():
    native = kernels()
    rest, weight, joint = np.ones((2, 3, 8), np.float32), np.ones((2, 4, 8), np.float32), np.zeros((1, 4), np.int32)
    with pytest.raises(ValueError, match="fit"):
        native.touch(None, rest, joint, weight, None, 10, np.ones((10, 3), np.float32))
