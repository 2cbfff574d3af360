"""BVH motion capture files: all dialects that the reference files and users' files show.

A BVH has no unit and no stated up axis; both are found from the figure, and `Motion.notes` says what was found and why.
Source: note motion.md, 3.1; the rules agree with the AMC twin of the CMU clips to 1e-4 file units.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vitruvian.body.rotations import from_euler, from_vector, inverse, multiply, rotate, to_euler
from vitruvian.body.types import Floats, Ints, Skeleton
from vitruvian.errors import FileError, VitruvianError, warn
from vitruvian.formats.atomic import atomic
from vitruvian.motion.names import match
from vitruvian.motion.turns import positions, world_rotations
from vitruvian.motion.types import Motion
from vitruvian.native import parse_floats

UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "cmu": 0.0254 / 0.45}
_UP = {"x": 0, "y": 1, "z": 2}


@dataclass(slots=True)
class _Joint:
    name: str
    parent: int
    offset: Floats | None = None
    channels: tuple[str, ...] | None = None
    ends: list[tuple[str, Floats]] = field(default_factory=list)


def read_bvh(path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None) -> Motion:
    """The clip in a BVH file, in metres, Y up, on a skeleton of its own.

    `unit` metres per file unit or one of m, dm, cm, mm, in; by default the common unit that makes the figure a person
    (standing height 1.0 to 2.3 m, nearest 1.7). `up` "x", "y" or "z", "-" before it for downwards; by default the axis
    from hips to head. End Sites become Sites named after their joint with `_tip` unless they have a name.
    Raises `FileError` with the line, or with the frame for bad numbers.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise FileError(path, 0, f"can't be read ({error.strerror})") from None
    split = re.search(rb"^[ \t]*MOTION[ \t]*\r?$", data, re.MULTILINE | re.IGNORECASE)
    joints = _hierarchy(path, data[: split.start()] if split else data, complete=split is not None)
    if split is None:
        raise FileError(
            path, data.count(b"\n") + 1, "expected the line MOTION after the hierarchy, found the end of the file"
        )
    frames, frame_time, start = _head(path, data, split.end())
    values = _values(path, data, start, frames, joints)
    return _motion(path, joints, values, 1.0 / frame_time, unit, up)


def _hierarchy(path: object, data: bytes, *, complete: bool) -> list[_Joint]:
    """Joints in file order from the text before MOTION."""
    joints: list[_Joint] = []
    seen: set[str] = set()
    stack: list[int | None] = []  # indices of open joints; None for an open End Site
    pending = ""  # what the next brace opens: "joint" or "end"
    end_name = ""
    begun = False
    number = 1
    lines = data.decode("latin-1").removeprefix("\u00ef\u00bb\u00bf").split("\n")
    for number, raw in enumerate(lines, 1):
        for text in re.findall(r"[{}]|[^{}\s][^{}]*", raw):
            words = text.split()
            key = words[0].upper()
            if not begun:
                if words != words[:1] or key != "HIERARCHY":
                    raise FileError(path, number, f"expected HIERARCHY at the start of a BVH file, found {text[:40]!r}")
                begun = True
            elif key == "{":
                if not pending:
                    raise FileError(path, number, "expected ROOT, JOINT or End Site before {")
                stack.append(None if pending == "end" else len(joints) - 1)
                pending = ""
            elif key == "}":
                if not stack or pending:
                    raise FileError(path, number, "expected { before }")
                closed = stack.pop()
                if closed is not None and joints[closed].offset is None:
                    raise FileError(path, number, f"joint {joints[closed].name[:40]!r} has no OFFSET")
            elif pending:
                raise FileError(path, number, f"expected {{ after a name, found {text[:40]!r}")
            elif key in ("ROOT", "JOINT"):
                name = " ".join(words[1:])
                if not name:
                    raise FileError(path, number, f"expected a name after {key}")
                if key == "ROOT" and joints:
                    raise FileError(
                        path, number, f"a second ROOT ({name[:40]}): expected one figure per file, split it"
                    )
                if key == "JOINT" and (not stack or stack[-1] is None):
                    raise FileError(path, number, f"JOINT {name[:40]} stands outside of a joint")
                if name in seen:
                    raise FileError(path, number, f"the joint name {name[:40]!r} is used twice, expected unique names")
                seen.add(name)
                joints.append(_Joint(name, -1 if not stack else stack[-1]))  # type: ignore[arg-type]
                pending = "joint"
            elif not stack:
                raise FileError(path, number, f"expected ROOT, found {words[0][:40]!r}")
            elif key == "END":
                if stack[-1] is None:
                    raise FileError(path, number, "End Site stands in an End Site")
                end_name, pending = " ".join(words[2:]), "end"
            elif key == "OFFSET":
                offset = np.array(_numbers(path, number, words[1:], 3))
                if stack[-1] is None:
                    joints[stack[-2]].ends.append((end_name, offset))  # type: ignore[index]
                else:
                    joints[stack[-1]].offset = offset
            elif key == "CHANNELS":
                if stack[-1] is None:
                    raise FileError(path, number, "an End Site has no CHANNELS")
                joints[stack[-1]].channels = _channels(path, number, words)
            else:
                raise FileError(path, number, f"expected JOINT, OFFSET, CHANNELS or End Site, found {words[0][:40]!r}")
    if not joints:
        raise FileError(path, number, "expected HIERARCHY and a ROOT joint, found neither")
    if stack or pending:
        end = "MOTION" if complete else "the end of the file"
        raise FileError(path, number, f"expected }} before {end}: joint {joints[-1].name[:40]!r} is still open")
    return joints


def _numbers(path: object, line: int, words: list[str], count: int) -> list[float]:
    try:
        values = [float(w) for w in words]
    except ValueError:
        bad = next(w for w in words if not re.fullmatch(r"[-+.\deE]+", w) or not _is_number(w))
        hint = " (decimal commas are not allowed)" if "," in bad else ""
        raise FileError(path, line, f"expected a number, found {bad[:40]!r}{hint}") from None
    if len(values) != count or not np.isfinite(values).all():
        raise FileError(path, line, f"expected {count} finite numbers, found {' '.join(words)[:60]!r}")
    return values


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _channels(path: object, line: int, words: list[str]) -> tuple[str, ...]:
    """Channel names as "Xp" or "Zr", from the words of a CHANNELS line."""
    count = words[1] if len(words) > 1 else "nothing"
    if not count.isdigit() or int(count) != len(words) - 2:
        raise FileError(path, line, f"expected a count and that many channel names, found {' '.join(words[1:])[:60]!r}")
    channels = []
    for word in words[2:]:
        kind = re.fullmatch(r"([XYZ])(POSITION|ROTATION)", word.upper())
        if not kind or kind[1] + kind[2][0].lower() in channels:
            raise FileError(
                path, line, f"expected different channels such as Xposition or Zrotation, found {word[:40]!r}"
            )
        channels.append(kind[1] + kind[2][0].lower())
    return tuple(channels)


def _head(path: object, data: bytes, start: int) -> tuple[int, float, int]:
    """Frame count, frame time (s) and where the numbers begin."""
    pattern = rb"\s*Frames[ \t]*:?[ \t]*(\S+)[ \t]*\r?\n\s*Frame[ \t]*Time[ \t]*:?[ \t]*(\S+)[ \t]*(?:\r?\n|\r?$)"
    found = re.compile(pattern, re.IGNORECASE).match(data, start)
    line = data.count(b"\n", 0, start) + 2
    if not found:
        raise FileError(path, line, "expected 'Frames: count' and 'Frame Time: seconds' after MOTION")
    count, seconds = found[1].decode("latin-1"), found[2].decode("latin-1")
    if not count.isdigit() or len(count) > 12:
        raise FileError(path, line, f"expected a frame count, found {count[:40]!r}")
    time = _numbers(path, line + 1, [seconds], 1)[0]
    if not 0 < time <= 3600:
        raise FileError(path, line + 1, f"expected a frame time in seconds above zero, found {seconds[:40]}")
    if abs(time * round(1 / time) - 1) < 1e-4 and round(1 / time):
        time = 1 / round(1 / time)  # .0083333 means 1/120
    return int(count), time, found.end()


def _values(path: object, data: bytes, start: int, frames: int, joints: list[_Joint]) -> Floats:
    """The numbers (frames, channels), or an error that names the first bad line and frame."""
    width = sum(len(j.channels or ()) for j in joints)
    text = memoryview(data)[start:]
    comma = data.find(b",", start)
    try:
        if comma >= 0:
            raise _BadToken(comma - start, "numbers with a decimal point, found a comma")
        values = parse_floats(text)
    except ValueError as error:
        offset = int(getattr(error, "offset", 0))
        line = data.count(b"\n", 0, start + offset) + 1
        frame = _rows(data[start : start + offset + 1]) - 1
        what = str(error).partition(": ")[2] or str(error)
        raise FileError(path, line, f"frame {frame}: {what}") from None
    if width == 0:
        if values.size:
            raise FileError(path, 0, "no joint has CHANNELS but there are numbers after Frame Time")
        return np.zeros((frames, 0)) if frames <= 1 else np.zeros((1, 0))
    if len(values) < frames * width:
        number = data.count(b"\n", 0, start) + 1
        done = 0
        for extra, row in enumerate(bytes(text).split(b"\n")):
            count = len(row.split())
            if count not in (0, width):
                what = f"frame {done}: expected {width} numbers, one per channel, found {count}"
                raise FileError(path, number + extra, what)
            done += count == width
        last = data.count(b"\n") + (not data.endswith(b"\n"))
        raise FileError(
            path, last, f"expected {frames} frames, found {done}: the file is cut short or its count is wrong"
        )
    if len(values) > frames * width:
        warn(f"{path}: {len(values) - frames * width} numbers beyond the {frames} frames it announces are left out")
    return values[: frames * width].reshape(frames, width)


class _BadToken(ValueError):
    def __init__(self, offset: int, what: str):
        super().__init__(f"byte {offset}: expected {what}")
        self.offset = offset


def _rows(text: bytes) -> int:
    """How many lines with something on them."""
    return sum(1 for row in text.split(b"\n") if row.strip())


def _motion(
    path: object, joints: list[_Joint], values: Floats, fps: float, unit: float | str | None, up: str | None
) -> Motion:
    parents = np.array([j.parent for j in joints], dtype=np.int32)
    offsets = np.array([j.offset for j in joints])
    rest = np.zeros_like(offsets)
    for j, parent in enumerate(parents):
        rest[j] = offsets[j] + (rest[parent] if parent >= 0 else 0.0)
    rotation = _rotations(joints, values)
    shift = _shifts(joints, values, offsets)
    ends = [(i, name, point) for i, j in enumerate(joints) for name, point in j.ends]
    site_points = np.array([rest[i] + point for i, _, point in ends]).reshape(-1, 3)
    names = [j.name for j in joints]
    posed = sample(parents, rest, rotation, shift) if up is None else np.zeros((0, *rest.shape))
    try:
        turn, why_up = upright(names, rest, posed, up)
        scale, why_unit = metres(np.concatenate([rest, site_points]), turn, unit)
    except VitruvianError as error:
        raise FileError(path, 0, str(error)) from None
    site_names: list[str] = []
    for i, name, _ in ends:
        name = name if name and name not in site_names else f"{names[i]}_tip"
        while name in site_names:
            name += "_"
        site_names.append(name)
    if turn is not None:
        rotation = multiply(multiply(turn, rotation), inverse(turn))
        rest, site_points = rotate(turn, rest), rotate(turn, site_points)
        shift = None if shift is None else rotate(turn, shift)
    root, moving = np.zeros((len(values), 3)), None
    if shift is not None:
        root = shift[:, 0] * scale
        moving = shift * scale if np.abs(shift[:, 1:]).max(initial=0.0) > 1e-9 else None
    skeleton = Skeleton(
        tuple(names),
        parents,
        rest * scale,
        site_names=tuple(site_names),
        site_joints=np.array([i for i, _, _ in ends], dtype=np.int32),
        site_points=site_points * scale,
    )
    return Motion(
        skeleton,
        fps,
        rotation,
        root,
        joint_translation=moving,
        name=Path(str(path)).stem,
        notes=(why_unit, why_up),
    )


def _rotations(joints: list[_Joint], values: Floats) -> Floats:
    """Local rotations (F,J,4): the product of the channels in their order; joints with the same order go together."""
    out = np.zeros((len(values), len(joints), 4))
    out[..., 3] = 1.0
    groups: dict[str, tuple[list[int], list[int]]] = {}
    column = 0
    for j, joint in enumerate(joints):
        channels = joint.channels or ()
        order = "".join(c[0] for c in channels if c[1] == "r")
        if order:
            owner, columns = groups.setdefault(order, ([], []))
            owner.append(j)
            columns += [column + i for i, c in enumerate(channels) if c[1] == "r"]
        column += len(channels)
    for order, (owner, columns) in groups.items():
        angles = np.radians(values[:, _span(columns)]).reshape(len(values), len(owner), len(order))
        if len(order) == 3:
            turns = from_euler(angles, order)
            if len(owner) == len(joints):
                return turns
            out[:, _span(owner)] = turns
            continue
        axes = np.eye(3)[["XYZ".index(c) for c in order]]
        turns = from_vector(angles[..., 0, None] * axes[0])
        out[:, owner] = turns if len(order) == 1 else multiply(turns, from_vector(angles[..., 1, None] * axes[1]))
    return out


def _span(places: list[int]) -> slice | list[int]:
    """The same places as a slice when they are in a row: no copy."""
    row = places == list(range(places[0], places[0] + len(places)))
    return slice(places[0], places[0] + len(places)) if row else places


def _shifts(joints: list[_Joint], values: Floats, offsets: Floats) -> Floats | None:
    """Translations (F,J,3) in file units: position channels replace OFFSET, so the offset is taken off them."""
    out = None
    column = 0
    for j, joint in enumerate(joints):
        for channel in joint.channels or ():
            if channel[1] == "p":
                if out is None:
                    out = np.zeros((len(values), len(joints), 3))
                axis = _UP[channel[0].lower()]
                out[:, j, axis] = values[:, column] - offsets[j, axis]
            column += 1
    return out


def sample(parents: Ints, rest: Floats, rotation: Floats, shift: Floats | None) -> Floats:
    """Joint positions (n,J,3) of at most 16 frames spread over the clip."""
    pick = np.unique(np.linspace(0, max(len(rotation) - 1, 0), min(16, len(rotation))).astype(int))
    root = np.zeros((len(pick), 3)) if shift is None else shift[pick, 0]
    world = world_rotations(parents, rotation[pick])
    return positions(parents, rest, world, root, None if shift is None else shift[pick])


def upright(names: list[str], rest: Floats, posed: Floats, up: str | None) -> tuple[Floats | None, str]:
    """The turn that brings the file's up axis to Y (None when it is), and why."""
    if up is not None:
        axis, sign = _UP.get(up.lower().lstrip("+-"), -1), -1.0 if up.startswith("-") else 1.0
        if axis < 0:
            raise VitruvianError(f"up: expected x, y or z, found {up!r}")
        why = f"up axis {up.upper()}: as asked for"
    else:
        found = {h: names.index(n) for n, h in match(names).items()}
        low, high = found.get("humanoid_root", 0), found.get("skullbase", found.get("vc4"))
        if high is not None and np.linalg.norm(rest[high] - rest[low]) > 0:
            both = [(p[high] - p[low]) / max(np.linalg.norm(p[high] - p[low]), 1e-300) for p in [*posed, rest]]
            # the clip decides when it mostly stands upright, because what lies down at rest may stand up in it
            spine, why = np.mean(both[:-1], axis=0) if len(posed) else both[-1], "from hips to head in the clip"
            if np.abs(spine).max() < 0.8:
                spine, why = both[-1], "from hips to head at rest"
        else:
            size = np.ptp(rest, axis=0)
            spine = np.eye(3)[1 if size[1] >= size[2] else 2]
            why = "the figure is longest along it, no head was recognised"
        axis = int(np.argmax(np.abs(spine)))
        sign = 1.0 if spine[axis] >= 0 else -1.0
        why = f"up axis {'-' if sign < 0 else ''}{'XYZ'[axis]}: {why}"
    quarter = np.pi / 2
    if axis == 1:
        return (None if sign > 0 else from_vector([np.pi, 0.0, 0.0])), why
    return from_vector([0.0, 0.0, sign * quarter] if axis == 0 else [-sign * quarter, 0.0, 0.0]), why


def metres(points: Floats, turn: Floats | None, unit: float | str | None) -> tuple[float, str]:
    """Metres per file unit, and why."""
    if unit is not None:
        scale = UNITS.get(unit, 0.0) if isinstance(unit, str) else float(unit)
        if not 0 < scale < 1e6:
            raise VitruvianError(
                f"unit: expected metres per unit above zero or one of {', '.join(UNITS)}, found {unit!r}"
            )
        return scale, f"unit {scale:.6g} m: as asked for"
    height = float(np.ptp(points if turn is None else rotate(turn, points), axis=0)[1])
    good = {name: s for name, s in UNITS.items() if 1.0 <= s * height <= 2.3}
    if not good:
        raise VitruvianError(
            f"no common unit makes the figure ({height:.4g} units high) a person; say unit=m, cm, mm or in"
        )
    name = min(good, key=lambda n: abs(good[n] * height - 1.7))
    return good[name], f"unit {good[name]:.6g} m ({name}): the figure stands {good[name] * height:.2f} m high"


def write_bvh(
    motion: Motion,
    path: str | os.PathLike[str],
    *,
    unit: float | str = "cm",
    order: str = "ZYX",
    root_order: str = "ZXY",
) -> None:
    """Write a clip: all joints, the first with positions (all of them when joints slide), End Sites for leaves.

    Angles are continuous from frame to frame. Positions are absolute, as BVH wants them (they replace OFFSET). `unit`
    metres per unit of the file, or m, dm, cm, mm, in; `order`, `root_order` the order of the rotation channels.
    Several roots are hung under the first. The file is complete or absent.
    """
    scale = UNITS.get(unit, 0.0) if isinstance(unit, str) else float(unit)
    if scale <= 0:
        raise VitruvianError(f"unit: expected metres per unit above zero or one of {', '.join(UNITS)}, found {unit!r}")
    skeleton = motion.skeleton
    parents = np.where((skeleton.parents < 0) & (np.arange(len(skeleton)) > 0), 0, skeleton.parents)
    tree = _depth_first(parents)
    lines = ["HIERARCHY"]
    depth = np.zeros(len(skeleton), int)
    opened: list[int] = []
    leaf = ~np.isin(np.arange(len(skeleton)), parents)
    columns = []
    shift = motion.joint_translation
    for j in tree:
        while opened and opened[-1] != parents[j]:
            opened.pop()
            lines.append("\t" * len(opened) + "}")
        depth[j] = len(opened)
        tab = "\t" * len(opened)
        parent = parents[j]
        offset = (skeleton.centers[j] - (skeleton.centers[parent] if parent >= 0 else 0.0)) / scale
        letters = (root_order if parent < 0 else order).upper()
        lines += [f"{tab}{'ROOT' if parent < 0 else 'JOINT'} {skeleton.names[j]}", tab + "{"]
        opened.append(j)
        tab += "\t"
        lines.append(f"{tab}OFFSET {_text(offset)}")
        turning = " ".join(f"{c}rotation" for c in letters)
        angles = np.degrees(to_euler(motion.rotation[:, j], letters, continuous=True))
        if parent < 0 or shift is not None:
            lines.append(f"{tab}CHANNELS 6 Xposition Yposition Zposition {turning}")
            moved = motion.translation if parent < 0 else shift[:, j]  # type: ignore[index]
            columns.append(moved / scale + offset)
        else:
            lines.append(f"{tab}CHANNELS 3 {turning}")
        columns.append(angles)
        sites = np.flatnonzero(skeleton.site_joints == j)
        if leaf[j]:
            end = (skeleton.site_points[sites[0]] - skeleton.centers[j]) / scale if sites.size else np.zeros(3)
            lines += [f"{tab}End Site", tab + "{", f"{tab}\tOFFSET {_text(end)}", tab + "}"]
    while opened:
        opened.pop()
        lines.append("\t" * len(opened) + "}")
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / motion.fps:.10g}"]
    table = np.concatenate(columns, axis=1) if len(motion) else np.zeros((0, 1))
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")
        form = " ".join(["%.6f"] * table.shape[1]) + "\n"
        file.writelines(form % tuple(row) for row in (table + 0.0).tolist())


def _depth_first(parents: Floats) -> list[int]:
    children: list[list[int]] = [[] for _ in parents]
    for j, p in enumerate(parents):
        if p >= 0:
            children[p].append(j)
    order, stack = [], [0]
    while stack:
        j = stack.pop()
        order.append(j)
        stack.extend(reversed(children[j]))
    return order


def _text(v: Floats) -> str:
    return " ".join(f"{x:.6f}" for x in np.asarray(v) + 0.0)
