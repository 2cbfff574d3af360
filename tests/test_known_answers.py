"""Joint matrices and skin of real files against answers that browsers give (X_ITE, X3DOM)."""

import numpy as np
import pytest

from vitruvian.body.kinematics import joint_matrices, joint_positions
from vitruvian.body.pack import pack
from vitruvian.deform.deformer import deformer
from vitruvian.formats import x3d
from vitruvian.hanim.view import humanoids

POSE = {
    "l_shoulder": (0, 0, 1, 1.5707963),
    "l_elbow": (1, 0, 0, -1),
    "l_hip": (1, 0, 0, -0.6),
    "l_knee": (1, 0, 0, 0.8),
    "vl5": (0, 1, 0, 0.3),
}
MOVED = {
    "HAnim2SpecificationLOA3Illustrated.x3d": {
        "l_elbow": (0.485157, 1.436100, -0.216971),
        "l_radiocarpal": (0.684828, 1.433100, -0.035847),
        "l_talocrural": (0.110100, 0.186537, 0.079793),
        "skullbase": (0.034235, 1.620900, 0.018607),
    },
    "JinNoAnimations_Fixed.x3d": {"l_radiocarpal": (0.630893, 1.359540, 0.004170)},
}


def posed(shared, name):
    humanoid = humanoids(x3d.read_x3d(shared / "data" / "hanim" / name))[0]
    for joint, rotation in POSE.items():
        humanoid.joint(joint).rotation = np.array(rotation, dtype=np.float64)
    return pack(humanoid)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", MOVED)
def test_moved_joint_centers(shared, name):
    body = posed(shared, name)
    centers = joint_positions(body.skeleton, joint_matrices(body.skeleton))[0]
    for joint, expected in MOVED[name].items():
        assert np.abs(centers[body.skeleton.index[joint]] - expected).max() < 1e-6


@pytest.mark.filterwarnings("ignore")
def test_moved_skin(shared):
    body = posed(shared, "JinNoAnimations_Fixed.x3d")
    skin = body.skin
    assert len(skin.rest) == 2179
    assert skin.weights.counts.max() <= 4
    assert np.abs(skin.weights.sums - 1).max() < 2e-5
    points = deformer("linear", body)(joint_matrices(body.skeleton))[0]
    assert np.abs(points[787] - (0.843202, 1.331000, 0.165058)).max() < 1e-6
    assert (np.linalg.norm(points - skin.rest, axis=1) > 1e-5).sum() == 1838
