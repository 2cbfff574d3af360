"""Small capture files for tests: walking markers, C3D by every processor, models of OpenSim, and mutations."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterable

import numpy as np

LABELS = ("LFHD", "RFHD", "C7", "STRN", "LASI", "RASI", "LKNE", "RKNE", "LHEE", "RHEE", "LTOE", "RTOE")
_HEIGHTS = (1.62, 1.62, 1.45, 1.25, 0.98, 0.98, 0.5, 0.5, 0.06, 0.06, 0.04, 0.04)


def cloud(frames: int = 6, labels: int = len(LABELS)) -> np.ndarray:
    """(F,M,3) metres, Y up, of a figure that walks along Z; figures exact in float32 and as whole millimetres."""
    out = np.zeros((frames, labels, 3))
    for m in range(labels):
        side = 0.125 if m % 2 == 0 else -0.125
        out[:, m] = [side, _HEIGHTS[m % len(_HEIGHTS)], 0.25]
        out[:, m, 2] += 0.0625 * np.arange(frames) + 0.03125 * (m % 3)
    return np.round(out * 1000) / 1000


def _dec(values: np.ndarray) -> bytes:
    """float32 as a VAX writes them: four times as large an exponent, 16-bit words swapped."""
    bits = (np.asarray(values, "<f4") * np.float32(4)).view("<u4")
    return np.ascontiguousarray(bits.view("<u2").reshape(-1, 2)[:, ::-1]).tobytes()


def c3d(
    points: np.ndarray,
    labels: list[str],
    *,
    processor: str = "Intel",
    real: bool = True,
    rate: float = 100.0,
    groups: dict[str, dict[str, object]] | None = None,
    analog: np.ndarray | None = None,
    samples: int = 1,
    first: int = 1,
) -> bytes:
    """A C3D of points (F,M,3) in millimetres, Z up; NaN is written as missing. analog (F*samples,C)."""
    end = ">" if processor == "MIPS" else "<"
    shorts = lambda *v: struct.pack(f"{end}{len(v)}h", *[int(np.int16(np.uint16(x & 0xFFFF))) for x in v])  # noqa: E731
    floats = _dec if processor == "DEC" else (lambda v: np.asarray(v, f"{end}f4").tobytes())
    count, width = len(points), 0 if analog is None else analog.shape[1] * samples
    scale = -0.1 if real else 0.5
    there: dict[str, dict[str, object]] = {
        "POINT": {
            "USED": points.shape[1], "SCALE": scale, "RATE": rate, "FRAMES": count,
            "LABELS": labels[:255], "UNITS": ["mm"], "X_SCREEN": ["+X"], "Y_SCREEN": ["+Z"],
        }
    }  # fmt: skip
    if labels[255:]:
        there["POINT"]["LABELS2"] = labels[255:]
    for name, more in (groups or {}).items():
        there[name] = {**there.get(name, {}), **more}
    blob = b""
    for number, (group, parameters) in enumerate(there.items(), 1):
        blob += struct.pack("bb", len(group), -number) + group.encode() + shorts(3) + b"\0"
        for name, value in parameters.items():
            if value is None:
                continue
            if isinstance(value, list):
                size = max([len(v) for v in value] + [1])
                body = struct.pack("bBBB", -1, 2, size, len(value)) + b"".join(v.encode().ljust(size) for v in value)
            elif isinstance(value, np.ndarray):
                dims = bytes(value.shape[::-1])
                body = struct.pack("bB", 4, len(dims)) + dims + floats(value.reshape(-1))
            elif isinstance(value, float):
                body = struct.pack("bB", 4, 0) + floats([value])
            else:
                body = struct.pack("bB", 2, 0) + shorts(int(value))
            blob += struct.pack("bb", len(name), number) + name.encode() + shorts(len(body) + 3) + body + b"\0"
    blob += b"\0\0"
    blocks = -(-(len(blob) + 4) // 512)
    kind = {"Intel": 84, "DEC": 85, "MIPS": 86}[processor]
    parameters_block = bytes([1, 80, blocks, kind]) + blob
    begin = 2 + blocks
    head = b"\x02\x50" + shorts(points.shape[1], width, first, first + count - 1, 10)
    head += floats([scale]) + shorts(begin, samples if analog is not None else 0) + floats([rate])
    rows = np.zeros((count, points.shape[1], 4))
    rows[..., :3] = np.nan_to_num(points) / (1 if real else scale)
    rows[np.isnan(points).any(axis=-1), 3] = -1
    table = rows.reshape(count, -1)
    if analog is not None:
        table = np.concatenate([table, analog.reshape(count, width)], axis=1)
    body = floats(table.reshape(-1)) if real else shorts(*np.round(table.reshape(-1)).astype(int))
    return (
        head.ljust(512, b"\0")
        + parameters_block.ljust(512 * blocks, b"\0")
        + body.ljust(-(-len(body) // 512) * 512, b"\0")
    )


ASF = """:version 1.10
:name tiny
:units
  mass 1.0
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name lfemur
    direction 0.34202 -0.939693 0
    length 14.5
    axis 0 0 20 XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
    id 2
    name ltibia
    direction 0 -1 0
    length 1.25
    axis 0 0 20 XYZ
    dof rx
    limits (-10.0 170.0)
  end
  begin
    id 3
    name head
    direction 0 1 0
    length 12.5
    axis 0 0 0 XYZ
  end
:hierarchy
  begin
    root lfemur head
    lfemur ltibia
  end
"""
AMC = """#!OML:ASF tiny.ASF
:FULLY-SPECIFIED
:DEGREES
1
root 1 17 2 5 10 15
lfemur 10 20 30
ltibia 40
2
root 1.5 17 2 5 10 15
lfemur 11 21 31
ltibia 41
3
root 2 17 2 5 10 15
lfemur 12 22 32
ltibia 42
"""

_WORDS = (
    b"nan inf -inf 1e400 1e39 -1 0 1 2147483648 99999999999999999999 1,5 1.2.3 5_0 DROPOUT $Order $Points root begin end "
    b"dof rx limits ( ) :root :bonedata mm endheader \t \n \0 \xff : time Frame#"
).split(b" ")


def mutated(data: bytes, seed: int) -> bytes:
    """`data` changed at random: bytes flipped, cut short, pieces and words doubled, left out or exchanged."""
    rng = random.Random(seed)
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        if not out:
            break
        at, size = rng.randrange(len(out)), rng.choice((1, 4, 20, 200))
        how = rng.randrange(7)
        if how == 0:
            out[at] = rng.randrange(256)
        elif how == 1:
            del out[at:]
        elif how == 2:
            del out[at : at + size]
        elif how == 3:
            out[at:at] = out[at : at + size]
        elif how == 4:
            out[at : at + rng.choice((0, 1, 5))] = rng.choice(_WORDS)
        elif how == 5:
            out[at] ^= 1 << rng.randrange(8)
        else:
            other = rng.randrange(len(out))
            out[at : at + size], out[other : other + size] = out[other : other + size], out[at : at + size]
    return bytes(out)


# A leg of OpenSim: the shank slides along X by 0.1 b^3 while it turns by b
AXIS = '<TransformAxis name="{}"><coordinates>{}</coordinates><axis>{}</axis><function>{}</function></TransformAxis>'
LINE = "<LinearFunction><coefficients>1 0</coefficients></LinearFunction>"
CURVE = (
    "<MultiplierFunction><function><SimmSpline><x>-2 -1 0 1 2</x><y>-8 -1 0 1 8</y></SimmSpline></function>"
    "<scale>0.1</scale></MultiplierFunction>"
)


def body(name: str, parent: str, axes: list[str], coordinates: list[str], place: str = "0 0 0") -> str:
    """A body of an OpenSim 2.3 model on a custom joint."""
    items = "".join(
        f'<Coordinate name="{c}"><default_value>0</default_value><locked>false</locked></Coordinate>'
        for c in coordinates
    )
    return (
        f'<Body name="{name}"><Joint><CustomJoint name="j"><parent_body>{parent}</parent_body><location_in_parent>{place}'
        f"</location_in_parent><orientation_in_parent>0 0 0</orientation_in_parent><location>0 0 0</location><orientation>"
        f"0 0 0</orientation><CoordinateSet><objects>{items}</objects></CoordinateSet><SpatialTransform>{''.join(axes)}"
        f"</SpatialTransform></CustomJoint></Joint></Body>"
    )


def model(*bodies: str, markers: Iterable[tuple[str, str, str]] = ()) -> str:
    """An OpenSim 2.3 model; markers are (name, body, place)."""
    marks = "".join(f'<Marker name="{n}"><body>{b}</body><location>{p}</location></Marker>' for n, b, p in markers)
    return (
        '<?xml version="1.0"?><OpenSimDocument Version="20303"><Model name="m"><length_units>meters</length_units>'
        f'<BodySet><objects><Body name="ground"/>{"".join(bodies)}</objects></BodySet>'
        f"<MarkerSet><objects>{marks}</objects></MarkerSet></Model></OpenSimDocument>"
    )


THIGH = body("thigh", "ground", [AXIS.format("rotation1", "a", "0 0 1", LINE)], ["a"], "0 1 0")
SHANK = body(
    "shank",
    "thigh",
    [AXIS.format("rotation1", "b", "0 0 1", LINE), AXIS.format("translation1", "b", "1 0 0", CURVE)],
    ["b"],
    "0 -0.5 0",
)
MARKS = [
    ("T1", "thigh", "0.1 -0.2 0"),
    ("T2", "thigh", "0 -0.4 0.1"),
    ("S1", "shank", "0.1 -0.2 0"),
    ("S2", "shank", "0 -0.4 0.1"),
]
