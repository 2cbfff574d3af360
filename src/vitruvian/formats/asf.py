"""ASF and AMC: Acclaim's skeletons and motions, read and written as pairs.

A bone of an ASF becomes a joint at the bone's start; the ends of bones without children become Sites. With C the bone's
axis and M the turn of an AMC row, the local turn is C M C^-1. Source: note motion.md, 3.2, checked there against the BVH
of the same clip.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vitruvian.body.rotations import from_euler, from_vector, inverse, multiply, rotate
from vitruvian.body.types import Floats, Skeleton
from vitruvian.errors import FileError, VitruvianError, warn
from vitruvian.formats.bvh import metres, sample, upright
from vitruvian.formats.rows import MOST_NAMES, content, number, text_lines, whole
from vitruvian.motion.markers import FARTHEST
from vitruvian.motion.types import Motion

FPS = 120.0  # what AMC files are taken at when nobody says it: they hold no rate
_DOF = ("tx", "ty", "tz", "rx", "ry", "rz", "l")


@dataclass(slots=True)
class _Bone:
    name: str
    line: int
    direction: Floats = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    axis: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0]))
    dof: tuple[str, ...] = ()
    limits: list[tuple[float, float]] = field(default_factory=list)
    parent: int = -1


@dataclass(frozen=True)
class _Figure:
    """An ASF: bones from the root on, parents first; the root's start; metres per unit; radians per angle of it."""

    bones: list[_Bone]
    start: Floats
    turn: Floats
    scale: float
    radians: float
    told: str


def skeleton_beside(path: str | os.PathLike[str]) -> Path:
    """The ASF of an AMC: of the same name, of the name's beginning (01_01.amc: 01.asf), or the only one in the folder.

    Raises FileError when there is none or no telling.
    """
    path = Path(path)
    there = sorted(p for p in path.parent.iterdir() if p.suffix.lower() == ".asf")
    fitting = [p for p in there if path.stem == p.stem or path.stem.startswith(f"{p.stem}_")]
    if not fitting and len(there) == 1:
        fitting = there
    if not fitting:
        found = "none" if not there else ", ".join(p.name for p in there[:4])
        raise FileError(path, 0, f"needs the .asf of its skeleton beside it, found {found}; say skeleton=FILE")
    return max(fitting, key=lambda p: len(p.stem))


def read_amc(
    path: str | os.PathLike[str],
    *,
    skeleton: str | os.PathLike[str] | None = None,
    unit: float | str | None = None,
    up: str | None = None,
    fps: float | None = None,
) -> Motion:
    """The clip in an AMC on the skeleton of its ASF, in metres, Y up.

    `skeleton` is the ASF, by default the one beside the file. An AMC holds no rate: `fps`, by default 120, noted. The ASF
    says the unit (its `length` is a fraction of an inch); `unit`, metres per file unit, wins. `up` as for BVH. Limits of
    degrees of freedom become `limits` in the frame of the bone's axis; axes without freedom have limits of zero.
    Raises FileError with the line, and the frame in an AMC.
    """
    figure = _figure(skeleton_beside(path) if skeleton is None else skeleton)
    if fps is not None and not 1 <= fps <= 2000:
        raise VitruvianError(f"fps: expected 1 to 2000 frames a second, found {fps:g}")
    values, radians = _values(path, figure)
    rate = f"rate {FPS:g} per second: the usual one, AMC holds none; fps= says another"
    rate = rate if fps is None else f"rate {fps:g} per second: as asked for"
    return _motion(path, figure, values, radians, fps or FPS, unit, up, rate)


def read_asf(path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None) -> Motion:
    """The skeleton of an ASF as a motion of one frame at rest. Options and errors as for `read_amc`."""
    figure = _figure(path)
    width = sum(len(b.dof) for b in figure.bones)
    return _motion(path, figure, np.zeros((1, width)), 1.0, FPS, unit, up, "a pose: no rate")


def _figure(path: str | os.PathLike[str]) -> _Figure:
    lines = text_lines(path)
    sections: dict[str, list[tuple[int, list[str]]]] = {}
    at: list[tuple[int, list[str]]] | None = None
    for n, line in enumerate(lines, 1):
        words = line.partition("#")[0].replace("(", " ( ").replace(")", " ) ").split()
        if not words:
            continue
        if words[0].startswith(":"):
            at = sections.setdefault(words[0][1:].lower(), [])
            words = words[1:]
        if at is None:
            raise FileError(path, n, f"expected a section such as :root in an ASF file, found {line.strip()[:40]!r}")
        if words:
            at.append((n, words))
    for name in ("root", "bonedata", "hierarchy"):
        if name not in sections:
            raise FileError(path, len(lines), f"expected the section :{name}, found the end of the file")
    unit, radians, told = 1.0, np.pi / 180, ""
    for n, words in sections.get("units", []):
        key = words[0].lower()
        if key == "length":
            unit = number(path, n, words[1] if len(words) > 1 else "", "the units' length")
            if not 1e-9 < unit < 1e9:
                raise FileError(path, n, f"expected a length above zero, found {words[1][:40]}")
            told = words[1]
        elif key == "angle" and len(words) > 1:
            if words[1].lower() not in ("deg", "rad"):
                raise FileError(path, n, f"expected angle deg or rad, found {words[1][:40]!r}")
            radians = 1.0 if words[1].lower() == "rad" else np.pi / 180
    root, start, turn = _root(path, sections["root"], radians)
    bones = _bones(path, sections["bonedata"], radians)
    order = _hierarchy(path, sections["hierarchy"], [root, *bones])
    return _Figure(order, start, turn, 0.0254 / unit, radians, told)


def _vector(path: object, line: int, words: list[str]) -> Floats:
    if len(words) < 3:
        raise FileError(path, line, f"expected three numbers, found {' '.join(words)[:40]!r}")
    out = np.array([number(path, line, w) for w in words[:3]])
    if np.abs(out).max() > FARTHEST:
        raise FileError(path, line, f"expected numbers below {FARTHEST:g}, found {' '.join(words)[:60]!r}")
    return out


def _axes(path: object, line: int, word: str) -> str:
    if sorted(word.upper()) != ["X", "Y", "Z"]:
        raise FileError(path, line, f"expected an order of axes such as XYZ, found {word[:40]!r}")
    return word.upper()


def _turn(angles: Floats, order: str) -> Floats:
    """Turns (...,4) of angles (...,3) about the axes `order`, the first of which is applied first."""
    return from_euler(np.asarray(angles)[..., ::-1], order[::-1])


def _root(path: object, lines: list[tuple[int, list[str]]], radians: float) -> tuple[_Bone, Floats, Floats]:
    bone = _Bone("root", lines[0][0] if lines else 0)
    bone.dof = ("tx", "ty", "tz", "rx", "ry", "rz")
    start, angles, order = np.zeros(3), np.zeros(3), "XYZ"
    for n, words in lines:
        key = words[0].lower()
        if key == "order":
            bone.dof = _dof(path, n, words[1:])
        elif key == "axis":
            order = _axes(path, n, words[1] if len(words) > 1 else "")
        elif key == "position":
            start = _vector(path, n, words[1:])
        elif key == "orientation":
            angles = _vector(path, n, words[1:]) * radians
    return bone, start, _turn(angles, order)


def _dof(path: object, line: int, words: list[str]) -> tuple[str, ...]:
    found = tuple(w.lower() for w in words)
    if not set(found) <= set(_DOF) or len(set(found)) != len(found):
        raise FileError(path, line, f"expected different ones of {' '.join(_DOF)}, found {' '.join(words)[:40]!r}")
    return found


def _bones(path: object, lines: list[tuple[int, list[str]]], radians: float) -> list[_Bone]:
    bones: list[_Bone] = []
    now: _Bone | None = None
    names: set[str] = {"root"}
    limits = False
    for n, words in lines:
        key = words[0].lower()
        if key == "begin":
            if now is not None:
                raise FileError(path, n, "expected end before another begin")
            now, limits = _Bone("", n), False
            continue
        if now is None:
            raise FileError(path, n, f"expected begin before a bone, found {words[0][:40]!r}")
        if key == "limits" or (limits and key == "("):
            limits = True
            pair = [w for w in words if w not in ("limits", "Limits", "LIMITS", "(", ")")]
            pair = [w for part in pair for w in part.split(",") if w]
            if len(pair) % 2:
                raise FileError(path, n, f"expected limits in pairs (low high), found {' '.join(words)[:60]!r}")
            now.limits += [(_limit(path, n, a), _limit(path, n, b)) for a, b in zip(pair[::2], pair[1::2])]
            continue
        limits = False
        if key == "end":
            if not now.name:
                raise FileError(path, n, "a bone has no name")
            if now.limits and len(now.limits) != len(now.dof):
                raise FileError(
                    path, n, f"bone {now.name[:40]}: expected limits for {len(now.dof)} dof, found {len(now.limits)}"
                )
            bones.append(now)
            now = None
        elif key == "name":
            now.name = " ".join(words[1:])
            if now.name in names:
                raise FileError(path, n, f"the bone name {now.name[:40]!r} is used twice, expected unique names")
            names.add(now.name)
            if len(names) > MOST_NAMES:
                raise FileError(path, n, f"expected at most {MOST_NAMES} bones")
        elif key == "direction":
            now.direction = _vector(path, n, words[1:])
        elif key == "length":
            now.length = number(path, n, words[1] if len(words) > 1 else "", "a bone's length")
            if not 0 <= now.length <= FARTHEST:
                raise FileError(path, n, f"expected a length from zero, found {words[1][:40]}")
        elif key == "axis":
            angles = _vector(path, n, words[1:]) * radians
            now.axis = _turn(angles, _axes(path, n, words[4] if len(words) > 4 else "XYZ"))
        elif key == "dof":
            now.dof = _dof(path, n, words[1:])
        elif key not in ("id", "bodymass", "cofmass"):
            warn(f"{path}:{n}: {words[0][:40]!r} of a bone is unknown and left out")
    if now is not None:
        raise FileError(path, lines[-1][0], f"bone {now.name[:40]!r} has no end")
    return bones


def _limit(path: object, line: int, word: str) -> float:
    if word.lower().lstrip("+-") in ("inf", "infinity"):
        return -np.inf if word.startswith("-") else np.inf
    return number(path, line, word, "a limit")


def _hierarchy(path: object, lines: list[tuple[int, list[str]]], bones: list[_Bone]) -> list[_Bone]:
    """Bones with parents first; those that hang nowhere are left out with a warning."""
    index = {b.name: i for i, b in enumerate(bones)}
    children: dict[int, list[int]] = {}
    placed = {0}
    for n, words in lines:
        if words[0].lower() in ("begin", "end"):
            continue
        for word in words:
            if word not in index:
                raise FileError(path, n, f"the hierarchy names a bone {word[:40]!r} that :bonedata does not have")
        for word in words[1:]:
            if index[word] in placed:
                raise FileError(path, n, f"bone {word[:40]!r} hangs in two places, expected one parent")
            placed.add(index[word])
            children.setdefault(index[words[0]], []).append(index[word])
    out: list[_Bone] = []
    stack = [(0, -1)]
    while stack:
        i, parent = stack.pop()
        bones[i].parent = parent
        out.append(bones[i])
        stack += [(c, len(out) - 1) for c in reversed(children.get(i, []))]
    if len(out) < len(bones):
        loose = next(b for b in bones if b not in out)
        warn(f"{path}:{loose.line}: bone {loose.name[:40]!r} hangs on nothing that leads to the root and is left out")
    return out


def _values(path: str | os.PathLike[str], figure: _Figure) -> tuple[Floats, float]:
    """Numbers (F,columns) of all bones' dof in the figure's order, and radians per angle."""
    data = content(path)
    if b"\0" in data[:4096]:
        raise FileError(path, 1, "expected text, found binary data")
    columns, at = {}, 0
    for bone in figure.bones:
        columns[bone.name.encode("utf-8")] = (at, len(bone.dof))
        at += len(bone.dof)
    radians = np.pi / 180
    frames: list[int] = []
    texts: list[bytes] = []
    starts: list[int] = []
    counts: list[int] = []
    lines: list[int] = []
    per_frame: set[bytes] = set()
    needed: set[bytes] = set()
    for n, line in enumerate(
        data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n"), 1
    ):
        words = line.split()
        if not words or words[0].startswith(b"#"):
            continue
        first = words[0]
        if first.startswith(b":"):
            key = first.lower()
            radians = np.pi / 180 if key == b":degrees" else 1.0 if key == b":radians" else radians
        elif len(words) == 1 and first.isdigit() and first not in columns:
            _complete(path, n, frames, per_frame, needed)
            needed = needed or set(per_frame)
            frame = whole(path, n, first.decode("latin-1"), "a frame number")
            if frames and frame <= frames[-1]:
                raise FileError(path, n, f"frame {frame}: expected a number above {frames[-1]}, frames rise")
            frames.append(frame)
            per_frame = set()
        else:
            name = first.decode("latin-1")[:40]
            if not frames:
                raise FileError(path, n, f"expected the number of the first frame, found {name!r}")
            if first not in columns:
                raise FileError(
                    path, n, f"frame {frames[-1]}: the skeleton has no bone {name!r}; is it the right .asf?"
                )
            start, count = columns[first]
            if len(words) - 1 != count:
                raise FileError(
                    path, n, f"frame {frames[-1]}: expected {count} numbers for {name}, found {len(words) - 1}"
                )
            if first in per_frame:
                raise FileError(path, n, f"frame {frames[-1]}: {name!r} stands twice, expected once")
            per_frame.add(first)
            texts.append(line[line.index(first) + len(first) :])
            starts.append((len(frames) - 1) * at + start)
            counts.append(count)
            lines.append(n)
    if not frames:
        raise FileError(path, data.count(b"\n") + 1, "expected frames, found the end of the file")
    _complete(path, data.count(b"\n") + 1, frames, per_frame, needed)
    numbers = _numbers(path, texts, counts, lines)
    out = np.zeros(len(frames) * at)
    size = np.array(counts)
    within = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
    out[np.repeat(np.array(starts), size) + within] = numbers
    return _whole_clip(path, frames, out.reshape(len(frames), at)), radians


def _complete(path: object, line: int, frames: list[int], have: set[bytes], needed: set[bytes]) -> None:
    """Every frame has the bones that the first one has."""
    if frames and (len(have) < len(needed) or not have):
        lost = sorted(needed - have) or [b"every bone"]
        raise FileError(path, line, f"frame {frames[-1]} ends without {lost[0].decode('latin-1')[:40]}")


def _numbers(path: object, texts: list[bytes], counts: list[int], lines: list[int]) -> Floats:
    from vitruvian.native import parse_floats

    try:
        joined = b"\n".join(texts)
        if b"," in joined:
            raise ValueError
        numbers = parse_floats(joined, sum(counts))
        if np.abs(numbers).max(initial=0.0) > FARTHEST:
            raise ValueError
        return numbers
    except ValueError:
        for text, line in zip(texts, lines):
            for word in text.decode("latin-1").split():
                if abs(number(path, line, word)) > FARTHEST:
                    raise FileError(path, line, f"expected numbers below {FARTHEST:g}, found {word[:40]}") from None
        raise


def _whole_clip(path: object, frames: list[int], values: Floats) -> Floats:
    """The clip with frames that the file leaves out held at the one before, with a warning."""
    span = frames[-1] - frames[0] + 1
    if span == len(frames):
        return values
    if span > 2 * len(frames) + 100:
        raise FileError(path, 0, f"holds {len(frames)} frames between number {frames[0]} and {frames[-1]}: too few")
    steps = np.diff(frames)
    after = int(np.argmax(steps > 1))
    warn(f"{path}: {span - len(frames)} frames are missing, the first after frame {frames[after]}: the pose is held")
    return np.repeat(values, [*steps, 1], axis=0)


def _motion(
    path: object,
    figure: _Figure,
    values: Floats,
    radians: float,
    fps: float,
    unit: float | str | None,
    up: str | None,
    rate: str,
) -> Motion:
    bones = figure.bones
    names = [b.name for b in bones]
    parents = np.array([b.parent for b in bones], dtype=np.int32)
    rest = np.zeros((len(bones), 3))
    for j, bone in enumerate(bones):
        if bone.parent >= 0:
            above = bones[bone.parent]
            rest[j] = rest[bone.parent] + _arm(above)
    limits = np.full((len(bones), 3, 2), np.nan)
    rotation = np.zeros((len(values), len(bones), 4))
    shift = np.zeros((len(values), len(bones), 3))
    at = 0
    for j, bone in enumerate(bones):
        own = values[:, at : at + len(bone.dof)]
        at += len(bone.dof)
        rotation[:, j], shift[:, j] = _local(bone, own, radians)
        if j:
            limits[j] = _limits(bone, figure.radians)
        if "l" in bone.dof and np.ptp(own[:, bone.dof.index("l")]) > 0:
            warn(f"{path}: bone {bone.name[:40]} changes its length, which is left out")
    shift[:, 0] += figure.start
    rotation[:, 0] = multiply(rotation[:, 0], figure.turn)
    leaves = np.setdiff1d(np.arange(len(bones)), parents)
    ends = np.array([rest[j] + _arm(bones[j]) for j in leaves]).reshape(-1, 3)
    posed = sample(parents, rest, rotation, shift) if up is None else np.zeros((0, *rest.shape))
    try:
        turn, why_up = upright(names, rest, posed, up)
        if unit is None and figure.told:
            scale = figure.scale
            why_unit = f"unit {scale:.6g} m: the skeleton says length {figure.told}, of an inch"
        else:
            scale, why_unit = metres(np.concatenate([rest, ends]), turn, unit)
    except VitruvianError as error:
        raise FileError(path, 0, str(error)) from None
    frames = np.array([b.axis for b in bones])
    if turn is not None:
        rotation = multiply(multiply(turn, rotation), inverse(turn))
        rest, ends, shift = rotate(turn, rest), rotate(turn, ends), rotate(turn, shift)
        frames = multiply(turn, frames)
    height = float(np.ptp(np.concatenate([rest, ends]), axis=0)[1]) * scale
    if not 0.4 < height < 3:
        warn(f"{path}: the figure is {height:.3g} m high; if that is wrong, say unit=")
    moving = np.abs(shift[:, 1:]).max(initial=0.0) > 1e-9
    skeleton = Skeleton(
        tuple(names),
        parents,
        rest * scale,
        limits=limits,
        limit_orientation=frames,
        site_names=tuple(f"{names[j]}_tip" for j in leaves),
        site_joints=leaves.astype(np.int32),
        site_points=ends * scale,
    )
    return Motion(
        skeleton,
        fps,
        rotation,
        shift[:, 0] * scale,
        joint_translation=shift * scale if moving else None,
        name=Path(str(path)).stem,
        notes=(why_unit, why_up, rate),
    )


def _arm(bone: _Bone) -> Floats:
    """From a bone's start to its end."""
    return bone.direction * bone.length


def _local(bone: _Bone, values: Floats, radians: float) -> tuple[Floats, Floats]:
    """Turns (F,4) and translations (F,3) of a bone relative to its parent, from the numbers (F,dof) of an AMC."""
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (len(values), 1))
    shift = np.zeros((len(values), 3))
    turning = [(i, d[1].upper()) for i, d in enumerate(bone.dof) if d[0] == "r"]
    if len(turning) == 3:
        turn = _turn(values[:, [i for i, _ in turning]] * radians, "".join(a for _, a in turning))
    else:
        for i, axis in turning:
            turn = multiply(from_vector(values[:, i, None] * radians * np.eye(3)["XYZ".index(axis)]), turn)
    for i, d in enumerate(bone.dof):
        if d[0] == "t":
            shift[:, "xyz".index(d[1])] = values[:, i]
    return multiply(multiply(bone.axis, turn), inverse(bone.axis)), rotate(bone.axis, shift)


def _limits(bone: _Bone, radians: float) -> Floats:
    """(3,2) about X, Y, Z of the bone's axes: zero where it has no freedom, NaN where its freedom has no limits."""
    out = np.zeros((3, 2))
    for i, d in enumerate(bone.dof):
        if d[0] == "r":
            pair = bone.limits[i] if bone.limits else (-np.inf, np.inf)
            low, high = sorted(pair)
            ends = np.array([low, high]) * radians
            out["xyz".index(d[1])] = np.where(np.isfinite(ends), ends, np.nan)
    return out
