"""AMASS-style npz: SMPL-family poses as axis-angle, read and written.

A pose file says how joints turn, not where they are: the places come from a body model that is not free. The figure used
here is our own plain one in the model's T pose, unless the file brings `rest_joints`, as those we write do.
Source: note motion.md, 3.7; the archive and its arrays are read without pickle, member by member, within bounds.
"""

from __future__ import annotations

import os
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from vitruvian.body.rotations import from_matrix, from_vector, inverse, multiply, rotate, to_vector
from vitruvian.body.types import Floats, Skeleton
from vitruvian.errors import FileError
from vitruvian.formats.atomic import atomic
from vitruvian.motion.markers import FARTHEST, UP_AXES, from_y_up, to_y_up
from vitruvian.motion.types import Motion

LARGEST = 1 << 29  # bytes of one array, unpacked
DENSEST = 300  # unpacked bytes per packed byte; motion has noise, bombs have none

_BODY = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot "
    "neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist"
).split()
_BODY_PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
_FINGERS = ("index", "middle", "pinky", "ring", "thumb")
# H-Anim joint of each joint of the body; fingers follow from their names
_HANIM = dict(
    zip(
        _BODY,
        "humanoid_root l_hip r_hip vl3 l_knee r_knee vt10 l_talocrural r_talocrural vt6 l_metatarsophalangeal_2 "
        "r_metatarsophalangeal_2 vc5 l_sternoclavicular r_sternoclavicular skullbase l_shoulder r_shoulder l_elbow "
        "r_elbow l_radiocarpal r_radiocarpal".split(),
    )
)
# Our own plain figure, 1.70 m, in a T pose: metres, Y up, facing +Z, left side; the right one is its mirror image.
_MIDDLE = {
    "pelvis": (0, 0.93, 0), "spine1": (0, 1.04, -0.01), "spine2": (0, 1.17, -0.01), "spine3": (0, 1.24, 0.0),
    "neck": (0, 1.44, -0.02), "head": (0, 1.52, 0.02), "jaw": (0, 1.53, 0.04),
}  # fmt: skip
_LEFT = {
    "hip": (0.085, 0.86, 0.0), "knee": (0.095, 0.48, 0.0), "ankle": (0.10, 0.08, -0.02), "foot": (0.11, 0.02, 0.11),
    "collar": (0.05, 1.40, 0.0), "shoulder": (0.17, 1.39, -0.01), "elbow": (0.45, 1.39, -0.01),
    "wrist": (0.70, 1.39, -0.01), "hand": (0.78, 1.39, -0.01), "eye": (0.03, 1.59, 0.09),
}  # fmt: skip
# From the floor under that figure to the model's origin, which lies in the chest: AMASS's `trans` moves that.
_ORIGIN = np.array([0.0, -1.15, 0.03])
_KNUCKLE = {
    "index": (0.795, 1.39, 0.02, 0.042, 0.025), "middle": (0.80, 1.39, -0.002, 0.045, 0.028),
    "ring": (0.795, 1.388, -0.022, 0.042, 0.026), "pinky": (0.785, 1.385, -0.042, 0.033, 0.02),
    "thumb": (0.725, 1.38, 0.025, 0.033, 0.03),
}  # fmt: skip


def _hand(side: str) -> list[str]:
    return [f"{side}_{finger}{k}" for finger in _FINGERS for k in (1, 2, 3)]


_HANDS = [*_hand("left"), *_hand("right")]
LAYOUTS: dict[int, list[str]] = {
    22: _BODY,
    24: [*_BODY, "left_hand", "right_hand"],
    52: [*_BODY, *_HANDS],
    55: [*_BODY, "jaw", "left_eye", "right_eye", *_HANDS],
}  # joints: SMPL's body, SMPL, SMPL with hands, SMPL-X


def figure(names: Sequence[str], rest: Floats | None = None) -> Skeleton:
    """The skeleton of joints with the model's names: at `rest` (J,3) or as our own plain figure, with end Sites."""
    parents = [_parent(name, names) for name in names]
    own = np.array([_place(name) for name in names]) + _ORIGIN
    centers = own if rest is None else rest
    ends = {"head": (0.0, 0.18, 0.0), "left_foot": (0.0, 0.0, 0.07), "right_foot": (0.0, 0.0, 0.07)}
    sites = [(j, name) for j, name in enumerate(names) if name in ends]
    return Skeleton(
        tuple(names),
        np.array(parents, dtype=np.int32),
        centers,
        site_names=tuple(f"{name}_tip" for _, name in sites),
        site_joints=np.array([j for j, _ in sites], dtype=np.int32),
        site_points=np.array([centers[j] + ends[name] for j, name in sites]).reshape(-1, 3),
    )


def _parent(name: str, names: Sequence[str]) -> int:
    if name in _BODY:
        up = _BODY_PARENTS[_BODY.index(name)]
        return up if up < 0 else names.index(_BODY[up])
    if name in ("jaw", "left_eye", "right_eye"):
        return names.index("head")
    side, _, part = name.partition("_")
    if part != "hand" and part[-1] != "1":
        return names.index(f"{side}_{part[:-1]}{int(part[-1]) - 1}")
    return names.index(f"{side}_wrist")


def _place(name: str) -> tuple[float, float, float]:
    if name in _MIDDLE:
        return _MIDDLE[name]
    side, _, part = name.partition("_")
    if part in _LEFT:
        x, y, z = _LEFT[part]
    else:
        x, y, z, first, second = _KNUCKLE[part[:-1]]
        along = (0.0, first, first + second)[int(part[-1]) - 1]
        slope = (0.8, -0.1, 0.6) if part.startswith("thumb") else (1.0, 0.0, 0.0)
        x, y, z = x + along * slope[0], y + along * slope[1], z + along * slope[2]
    return (x if side == "left" else -x, y, z)


def read_amass(path: str | os.PathLike[str], *, up: str | None = None, fps: float | None = None) -> Motion:
    """The clip in an npz of SMPL-family poses, in metres, Y up: 22, 24, 52 or 55 joints.

    Arrays: `poses` (T,J*3) axis-angle, or `root_orient`, `pose_body`, `pose_hand`; `trans` (T,3) metres;
    `mocap_framerate` or `mocap_frame_rate`, or `fps`. `up`, or the axis along which the trunk stands on the whole.
    Shapes of bodies (`betas`) are left out. Raises FileError naming the array, for bombs and pickles too.
    """
    with Archive(path) as archive:
        poses = _poses(path, archive)
        trans = archive.get("trans")
        rate = next((archive.get(k) for k in ("mocap_framerate", "mocap_frame_rate", "fps") if k in archive), None)
        rest = archive.get("rest_joints")
        shaped = "betas" in archive and bool(np.abs(archive.get("betas", np.zeros(1))).max(initial=0.0) > 0)
    frames, joints = poses.shape[:2]
    names = LAYOUTS[joints]
    if trans is None:
        trans = np.zeros((frames, 3))
    if trans.shape != (frames, 3):
        raise FileError(path, 0, f"trans: expected shape ({frames}, 3), found {trans.shape}")
    if rest is not None and rest.shape != (joints, 3):
        raise FileError(path, 0, f"rest_joints: expected shape ({joints}, 3), found {rest.shape}")
    for name, array in (("poses", poses), ("trans", trans), ("rest_joints", rest)):
        if array is not None and not (np.abs(array) <= FARTHEST).all():
            bad = np.argwhere(~(np.abs(array) <= FARTHEST))[0]
            raise FileError(path, 0, f"{name}: expected finite numbers, found {array[tuple(bad)]:g} at {bad.tolist()}")
    notes = ["unit 1 m: what the format means"]
    if fps is None:
        if rate is None or rate.size != 1:
            raise FileError(path, 0, "mocap_framerate: says no frame rate; say fps=...")
        fps = float(rate.reshape(-1)[0])
    if not (np.isfinite(fps) and 0 < fps <= 1e6):
        raise FileError(path, 0, f"mocap_framerate: expected a number above zero, found {fps:g}")
    rotation = from_vector(poses)
    axis, why = _up_axis(path, rotation[:, 0], up)
    skeleton = figure(names, rest)
    root = skeleton.centers[0]
    rotation[:, 0] = multiply(_turn(axis), rotation[:, 0])
    notes.append(why)
    if rest is None:
        notes.append("bones as long as those of our own plain figure: the file holds turns only")
    if shaped:
        notes.append("betas are left out: they need the body model")
    return Motion(
        skeleton, fps, rotation, to_y_up(trans + root, axis) - root, name=Path(path).stem, notes=tuple(notes)
    )  # fmt: skip


def _poses(path: object, archive: Archive) -> Floats:
    """(T,J,3)."""
    if "poses" in archive:
        poses = archive.get("poses")
    else:
        parts = [archive.get(k) for k in ("root_orient", "pose_body", "pose_hand") if k in archive]
        if len(parts) < 2 or any(p.ndim != 2 or len(p) != len(parts[0]) for p in parts if p is not None):
            raise FileError(path, 0, "poses: expected that array (or root_orient and pose_body), found none")
        poses = np.concatenate([p for p in parts if p is not None], axis=1)
    if poses is not None and poses.ndim == 3 and poses.shape[2] == 3:
        poses = poses.reshape(len(poses), -1)
    known = {3 * j: j for j in LAYOUTS}
    if poses is None or poses.ndim != 2 or poses.shape[1] not in known:
        found = "none" if poses is None else poses.shape
        raise FileError(path, 0, f"poses: expected (frames, {' or '.join(map(str, known))}), found {found}")
    return poses.reshape(len(poses), known[poses.shape[1]], 3)


def _up_axis(path: object, root: Floats, up: str | None) -> tuple[str, str]:
    """Which axis of the file points upwards, and why: the trunk's (its Y) on the whole."""
    if up is not None:
        axis = up.lower().lstrip("+")
        if axis not in UP_AXES:
            raise FileError(path, 0, f"up: expected x, y or z, - before it for downwards, found {up!r}")
        return axis, f"up axis {axis.upper()}: as asked for"
    mean = rotate(root, np.array([0.0, 1.0, 0.0])).mean(axis=0) if len(root) else np.zeros(3)
    at = int(np.argmax(np.abs(mean)))
    if not abs(mean[at]) > 0.75:
        raise FileError(path, 0, "poses: the trunk does not show which axis is up; say up=z (AMASS) or up=y")
    axis = ("-" if mean[at] < 0 else "") + "xyz"[at]
    return axis, f"up axis {axis.upper()}: the trunk stands along it"


def _turn(axis: str) -> Floats:
    """The quaternion of `to_y_up`."""
    return from_matrix(to_y_up(np.eye(3), axis).T)


def write_amass(motion: Motion, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Write a motion as an AMASS-style npz with 52 joints, Z up, metres. The report: {"lost": what it can't hold}.

    A motion on one of the model's layouts is written as it is. Others, H-Anim and every rig that retargeting knows, are
    carried to our plain figure first: its proportions and T pose. The file is complete or absent.
    """
    from vitruvian.motion.retarget import retarget

    names = list(motion.skeleton.names)
    lost = []
    if names not in LAYOUTS.values():
        names = LAYOUTS[52]
        target = figure(names)
        standing = replace(target, centers=target.centers - _ORIGIN, site_points=target.site_points - _ORIGIN)
        carried = retarget(motion, replace(standing, names=tuple(_hanim_name(n) for n in names)))
        lost = ["proportions: the poses are those of a plain figure of 1.70 m"]
        known = [n for n in carried.notes if n.startswith("not matched")]
        motion = replace(carried, skeleton=target, translation=carried.translation - _ORIGIN)
        lost += known
    if motion.weights:
        lost.append(f"{len(motion.weights)} weights of displacers: poses hold joints only")
    if motion.joint_translation is not None:
        lost.append("translations of joints other than the root: poses hold turns only")
    root = motion.skeleton.centers[0]
    rotation = motion.rotation.copy()
    rotation[:, 0] = multiply(inverse(_turn("z")), rotation[:, 0])
    arrays = {
        "poses": to_vector(rotation).reshape(len(motion), -1),
        "trans": from_y_up(motion.translation + root, "z") - root,
        "mocap_framerate": np.array(motion.fps),
        "betas": np.zeros(16),
        "gender": np.array("neutral"),
        "rest_joints": motion.skeleton.centers,
    }
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
    return {"frames": len(motion), "lost": lost}


def _hanim_name(name: str) -> str:
    if name in _HANIM:
        return _HANIM[name]
    side, _, part = name.partition("_")
    if part[:-1] not in _FINGERS:
        return name
    from vitruvian.motion.names import FINGER_JOINTS

    finger = {"thumb": 1, "index": 2, "middle": 3, "ring": 4, "pinky": 5}[part[:-1]]
    return f"{side[0]}_{FINGER_JOINTS[finger][int(part[-1]) - 1]}"


class Archive:
    """The arrays of an npz, read one by one: no pickle, no more bytes than the member has, no bombs."""

    def __init__(self, path: str | os.PathLike[str]):
        self.path = path
        try:
            self.zip = zipfile.ZipFile(path)
        except OSError as error:
            raise FileError(path, 0, f"can't be read ({error.strerror or error})") from None
        except (zipfile.BadZipFile, ValueError, NotImplementedError):
            raise FileError(path, 0, "expected an npz (a zip of arrays), found something else") from None
        self.members = {m.filename.removesuffix(".npy"): m for m in self.zip.infolist()}

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *_: object) -> None:
        self.zip.close()

    def __contains__(self, name: str) -> bool:
        return name in self.members

    def get(self, name: str, default: Any = None) -> Any:
        """An array as float64, or `default` when it is absent. Raises FileError naming it."""
        member = self.members.get(name)
        if member is None:
            return default
        size, packed = member.file_size, member.compress_size
        if size > LARGEST or (size > 1 << 24 and size > DENSEST * max(packed, 1)):
            raise FileError(
                self.path, 0, f"{name}: unpacks from {packed} to {size} bytes, expected at most {LARGEST} and {DENSEST} "
                "times as many; it may be a zip bomb"
            )  # fmt: skip
        try:
            with self.zip.open(member) as file:
                array = self._array(name, file, size)
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, NotImplementedError) as error:
            raise FileError(self.path, 0, f"{name}: can't be unpacked ({error})") from None
        return array.astype(np.float64)

    def _array(self, name: str, file: IO[bytes], size: int) -> np.ndarray:
        try:
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, fortran, dtype = read(file)
        except (ValueError, SyntaxError, tokenize.TokenError, TypeError, RecursionError, MemoryError) as error:
            raise FileError(self.path, 0, f"{name}: expected an array, its head can't be read ({error})") from None
        if dtype.hasobject or dtype.kind not in "fiu":
            raise FileError(self.path, 0, f"{name}: expected numbers, found {dtype}; pickles are never read")
        wanted = dtype.itemsize
        for n in shape:
            wanted *= max(int(n), 0)
        if wanted > size:
            raise FileError(self.path, 0, f"{name}: shape {shape} needs {wanted} bytes, the file has {size}")
        data = file.read(wanted)
        if len(data) < wanted:
            raise FileError(self.path, 0, f"{name}: expected {wanted} bytes, found {len(data)}")
        return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
