"""Wavefront OBJ: surfaces in and out; PLY and STL in, through trimesh.

Source: Wavefront's appendix B1 to the Advanced Visualizer manual; colours after the coordinates as MeshLab writes them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Part
from vitruvian.errors import FileError, VitruvianError, warn
from vitruvian.formats.atomic import atomic
from vitruvian.stage.clip import Clip, Mesh

if TYPE_CHECKING:
    from vitruvian.hanim.humanoid import Humanoid

MAX_BYTES = 1 << 29
MAX_CORNERS = 20_000  # of one face
# statements that say nothing about a triangle mesh; curves and patches (the rest of the format) are named when met
_QUIET = {
    "vn", "vp", "g", "o", "s", "usemtl", "mtllib", "mg", "p", "l", "usemap", "maplib", "lod", "bevel", "c_interp",
    "d_interp", "shadow_obj", "trace_obj", "call", "csh",
}  # fmt: skip


def read_obj(path: str | os.PathLike[str], *, unit: str = "m") -> Mesh:
    """The triangles of an OBJ file. Vertices keep the order of the file, so that indices stay valid.

    Polygons of any number of corners become triangles, concave ones by cutting ears. Texture coordinates and vertex
    colours are read; normals, groups and materials are not. unit: what one unit of the file is, kept in `Mesh.unit`.
    Raises `FileError` with the line for numbers that are none or not finite, indices outside their list and faces with
    fewer than three corners; and for files that are binary, larger than 512 MB or hold no triangle.
    """
    reader = _Reader(path)
    for number, line in reader.lines():
        word, _, rest = line.partition(" ")
        if word == "v":
            reader.vertex(number, rest)
        elif word == "f":
            reader.face(number, rest)
        elif word == "vt":
            reader.texture(number, rest)
        elif word and word[0] != "#" and word not in _QUIET:
            reader.other(number, word)
    return reader.mesh(unit)


class _Reader:
    def __init__(self, path: str | os.PathLike[str]):
        self.path = path
        self.vertices: list[list[float]] = []
        self.colors: list[list[float]] = []
        self.uv: list[list[float]] = []
        self.corners: list[int] = []  # all faces, one after the other
        self.textures: list[int] = []  # -1 where a corner has none
        self.sizes: list[int] = []
        self.at: list[int] = []  # line of each face
        self.strange: dict[str, int] = {}

    def fail(self, line: int, what: str) -> NoReturn:
        raise FileError(self.path, line, what) from None

    def lines(self) -> Iterator[tuple[int, str]]:
        """(line number, text) with continued lines put together, tabs as spaces."""
        try:
            if os.path.getsize(self.path) > MAX_BYTES:
                self.fail(0, f"expected an OBJ file of at most {MAX_BYTES >> 20} MB")
            data = Path(self.path).read_bytes()
        except OSError as error:
            self.fail(0, f"can't be read ({error.strerror})")
        if b"\0" in data[:1_000_000]:
            self.fail(0, "expected OBJ text, found binary data")
        text = data.decode("utf-8", "replace").replace("\t", " ").replace("\r\n", "\n").replace("\r", "\n")
        held, start = "", 0
        for number, line in enumerate(text.split("\n"), 1):
            if line.endswith("\\"):
                start = start or number
                held += line[:-1] + " "
                if len(held) > 1 << 20:
                    self.fail(number, "expected a line of at most 1 MB, found a longer one")
                continue
            whole = (held + line).strip()
            if whole:
                yield (start or number), whole
            held, start = "", 0

    def numbers(self, line: int, text: str, what: str, least: int) -> list[float]:
        words = text.split("#")[0].split()
        try:
            values = [float(w) for w in words]
        except ValueError:
            bad = next(w for w in words if not _is_number(w))
            self.fail(line, f"{what}: expected numbers, found {bad[:40]!r}")
        if len(values) < least:
            self.fail(line, f"{what}: expected {least} numbers, found {len(values)}")
        for v in values:
            if not -1e30 < v < 1e30:  # false for NaN too
                self.fail(line, f"{what}: expected finite numbers, found {v}")
        return values

    def vertex(self, line: int, text: str) -> None:
        values = self.numbers(line, text, "vertex", 3)
        self.vertices.append(values[:3])
        if len(values) >= 6:
            self.colors.append(values[3:6])

    def texture(self, line: int, text: str) -> None:
        values = self.numbers(line, text, "texture coordinate", 1)
        self.uv.append([values[0], values[1] if len(values) > 1 else 0.0])

    def face(self, line: int, text: str) -> None:
        words = text.split("#")[0].split()
        if not 3 <= len(words) <= MAX_CORNERS:
            self.fail(line, f"face: expected 3 to {MAX_CORNERS} corners, found {len(words)}")
        for word in words:
            first, _, rest = word.partition("/")
            second = rest.partition("/")[0]
            self.corners.append(self.index(line, first, len(self.vertices), "vertex"))
            self.textures.append(self.index(line, second, len(self.uv), "texture coordinate") if second else -1)
        self.sizes.append(len(words))
        self.at.append(line)

    def index(self, line: int, word: str, count: int, what: str) -> int:
        # int() takes thousands of digits and underscores; an index needs neither
        digits = word[1:] if word[:1] in "+-" else word
        if not (digits.isascii() and digits.isdigit() and len(digits) < 12):
            self.fail(line, f"face: expected the number of a {what}, found {word[:40]!r}")
        i = int(word)
        if i < 0:  # counts back from the last one so far
            i += count + 1
        if not 1 <= i < 1 << 31:  # larger than the list so far is looked at when the list is whole
            self.fail(line, f"face: expected a {what} in 1..{count}, found {word}")
        return i - 1

    def other(self, line: int, word: str) -> None:
        if not self.vertices and len(self.strange) > 20:
            self.fail(line, f"expected an OBJ statement, found {word[:40]!r}")
        self.strange.setdefault(word[:20], line)

    def mesh(self, unit: str) -> Mesh:
        if not self.vertices:
            self.fail(0, "expected vertices (lines that start with v), found none")
        if not self.sizes:
            self.fail(0, f"expected faces (lines that start with f), found none beside {len(self.vertices)} vertices")
        sizes, corners = np.array(self.sizes), np.array(self.corners)
        owner = np.repeat(np.arange(len(sizes)), sizes)
        textures = np.array(self.textures)
        for what, values, count in (("vertex", corners, len(self.vertices)), ("texture", textures, len(self.uv))):
            bad = np.flatnonzero(values >= count)
            if len(bad):
                line = self.at[owner[bad[0]]]
                self.fail(line, f"face: expected a {what} in 1..{count}, found {values[bad[0]] + 1}")
        if self.strange:
            names = ", ".join(list(self.strange)[:5])
            warn(f"{self.path}:{min(self.strange.values())}: statements that are not read: {names}")
        vertices = np.array(self.vertices)
        which = triangulate(vertices, corners, sizes)
        triangles = corners[which].astype(np.int32)
        uv = uv_triangles = None
        if self.uv and (textures >= 0).any():
            if (textures < 0).any():
                warn(f"{self.path}: some faces have no texture coordinates, so none are used")
            else:
                uv, uv_triangles = np.array(self.uv), textures[which].astype(np.int32)
                if len(uv) == len(vertices) and (triangles == uv_triangles).all():
                    uv_triangles = None
        colors = None
        if len(self.colors) == len(vertices):
            colors = np.array(self.colors)
            colors = np.clip(colors / (255 if colors.max(initial=0) > 1 else 1), 0, 1)
        name = Path(self.path).stem
        return Mesh(vertices, triangles, uv, colors, name=name, unit=unit, uv_triangles=uv_triangles)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def triangulate(vertices: Floats, corners: NDArray, sizes: NDArray) -> NDArray[np.int64]:
    """Triangles (T,3) as places in `corners` of polygons of these sizes, in their order.

    Convex polygons become fans round their first corner; ears are cut off the others.
    """
    start = np.cumsum(sizes) - sizes
    count = sizes - 2
    owner = np.repeat(np.arange(len(sizes)), count)
    k = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    fan = np.stack([start[owner], start[owner] + k + 1, start[owner] + k + 2], -1)
    if not (sizes > 3).any():
        return fan
    p = vertices[corners[fan]]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    total = np.stack([np.bincount(owner, normal[:, i], minlength=len(sizes)) for i in range(3)], -1)
    inverted = np.einsum("ti,ti->t", normal, total[owner]) < 0
    for face in np.unique(owner[inverted]):
        if sizes[face] > 2000:  # cutting ears costs the square of the corners
            continue
        own = np.arange(start[face], start[face] + sizes[face])
        fan[owner == face] = own[_ears(vertices[corners[own]], total[face])]
    return fan


def _ears(points: Floats, normal: Floats) -> NDArray[np.int64]:
    """Triangles (n-2,3) of a simple polygon (n,3), by cutting ears (Meisters 1975)."""
    drop = int(np.abs(normal).argmax())
    a, b = ((1, 2), (2, 0), (0, 1))[drop]
    flat = points[:, [a, b]] * ([1, 1] if normal[drop] > 0 else [1, -1])

    def cross(o: Floats, p: Floats, q: Floats) -> Floats:
        return (p[..., 0] - o[..., 0]) * (q[..., 1] - o[..., 1]) - (p[..., 1] - o[..., 1]) * (q[..., 0] - o[..., 0])

    left, out = list(range(len(points))), []
    while len(left) > 3:
        n = len(left)
        best = 1
        for i in range(n):
            o, p, q = (flat[left[(i + k) % n]] for k in (-1, 0, 1))
            if cross(o, p, q) <= 0:
                continue
            others = flat[[left[(i + k) % n] for k in range(2, n - 1)]]
            within = (cross(o, p, others) > 0) & (cross(p, q, others) > 0) & (cross(q, o, others) > 0)
            if not within.any():
                best = i
                break
        out.append([left[(best - 1) % n], left[best], left[(best + 1) % n]])
        left.pop(best)
    return np.array([*out, left])


def read_mesh(path: str | os.PathLike[str], *, unit: str = "m") -> Mesh:
    """The triangles of a PLY or STL file (trimesh reads it). STL corners at one place become one vertex.

    Raises `FileError` when it can't be read or holds no triangle.
    """
    kind = Path(path).suffix.lower().lstrip(".")
    if kind not in ("ply", "stl"):
        raise FileError(path, 0, f"expected a PLY or STL file, found the ending {kind!r}")
    try:
        if os.path.getsize(path) > MAX_BYTES:
            raise FileError(path, 0, f"expected a file of at most {MAX_BYTES >> 20} MB")
        import trimesh

        with open(path, "rb") as file:
            loaded = trimesh.load(file, file_type=kind, process=False)
        if not isinstance(loaded, trimesh.Trimesh):
            raise FileError(path, 0, "expected triangles, found none")
        if kind == "stl":
            loaded.merge_vertices()
        vertices, triangles = np.array(loaded.vertices, np.float64), np.array(loaded.faces, np.int32)
    except FileError:
        raise
    except OSError as error:
        raise FileError(path, 0, f"can't be read ({error.strerror})") from None
    except Exception as error:  # whatever a library makes of a broken file is one clear line here
        raise FileError(path, 0, f"is not a {kind.upper()} file that can be read ({type(error).__name__})") from None
    if not len(triangles):
        raise FileError(path, 0, "expected triangles, found none")
    try:
        colors = None
        visual = loaded.visual
        if isinstance(visual, trimesh.visual.ColorVisuals) and visual.kind == "vertex":
            colors = np.array(visual.vertex_colors[:, :3], np.float64) / 255
        return Mesh(vertices, triangles, None, colors, name=Path(path).stem, unit=unit)
    except VitruvianError as error:
        raise FileError(path, 0, str(error)) from None


def write_obj(
    thing: Mesh | Body | Clip | Humanoid, path: str | os.PathLike[str], *, time: float = 0.0
) -> dict[str, Any]:
    """Write a surface as OBJ: vertices with colours, texture coordinates with their seams, a group per part.

    Of a Clip the surface at `time` seconds, of a Body or Humanoid that of its own pose. The report:
    `vertices triangles` and `lost`, what OBJ could not carry, one sentence each, which are warnings too.
    Raises `VitruvianError` when there is no triangle.
    """
    lost: list[str] = []
    parts: tuple[Part, ...]
    if isinstance(thing, Mesh):
        vertices, triangles, uv, faces_uv = thing.vertices, thing.triangles, thing.uv, thing.uv_triangles
        colors, parts, name = thing.colors, (Part(thing.name, 0, len(thing.triangles)),), thing.name
        if uv is not None and faces_uv is None:
            faces_uv = triangles
    else:
        body, vertices = _posed(thing, time)
        skin = body.skin
        triangles, uv, faces_uv, colors = skin.triangles, skin.uv, skin.uv_triangles, skin.colors
        parts, name = skin.parts, body.name
        lost.append("OBJ holds no skeleton, weights or displacers: only the surface was written")
        if isinstance(thing, Clip) and thing.motion is not None:
            lost.append(f"OBJ holds no motion: this is the surface at {time:g} s")
        if colors is None and len(parts) > 1:
            colors = painted(len(vertices), triangles, parts)
    if not len(triangles):
        raise VitruvianError(f"{path}: there is no triangle to write")
    with atomic(path) as temporary:
        temporary.write_text(text_of(name, vertices, triangles, uv, faces_uv, colors, parts), encoding="utf-8")
    for sentence in lost:
        warn(f"{path}: {sentence}")
    return {"vertices": len(vertices), "triangles": int(len(triangles)), "lost": lost}


def painted(count: int, triangles: NDArray, parts: Sequence[Part]) -> Floats:
    """(count,3) sRGB of points whose triangles belong to parts."""
    each = np.repeat(np.array([p.color for p in parts]), [p.stop - p.start for p in parts], axis=0)
    out = np.zeros((count, 3))
    out[triangles.reshape(-1)] = np.repeat(each, 3, axis=0)
    return out


def text_of(
    name: str, vertices: Floats, triangles: NDArray, uv: Floats | None, faces_uv: NDArray | None, colors: Floats | None,
    parts: Sequence[Part],
) -> str:  # fmt: skip
    """An OBJ file of one object, a group for each part."""
    columns = vertices if colors is None else np.concatenate([vertices, colors], -1)
    form = "v %.7g %.7g %.7g" + ("" if colors is None else " %.4g %.4g %.4g")
    text = [f"# vitruvian\no {_word(name)}", *(form % tuple(row) for row in columns.tolist())]
    if uv is not None and faces_uv is not None:
        text += [f"vt {u:.7g} {v:.7g}" for u, v in uv.tolist()]
        both = np.stack([triangles, faces_uv], -1).reshape(-1, 6) + 1
        lines = [f"f {a}/{i} {b}/{j} {c}/{k}" for a, i, b, j, c, k in both.tolist()]
    else:
        lines = [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    for part in parts:
        text += [f"g {_word(part.name)}", *lines[part.start : part.stop]]
    return "\n".join(text) + "\n"


def _word(name: str) -> str:
    return "_".join(name.split()) or "body"


def _posed(thing: Body | Clip | Humanoid, time: float) -> tuple[Body, Floats]:
    """A body and its vertices (V,3) in the world at `time`."""
    from vitruvian.body.kinematics import joint_matrices
    from vitruvian.deform.deformer import deformer

    motion, how = None, "log"
    if isinstance(thing, Clip):
        body, motion, how = thing.body, thing.motion, thing.deformer
    elif isinstance(thing, Body):
        body = thing
    else:
        from vitruvian.body.pack import pack

        body = pack(thing)
    matrices = joint_matrices(body.skeleton, motion)
    if motion is not None:
        frame = round(time * motion.fps)
        frame = frame % len(motion) if motion.loop else min(max(frame, 0), len(motion) - 1)
        matrices = matrices[frame : frame + 1]
    moved = np.asarray(deformer(how, body)(matrices), np.float64).reshape(-1, 3)
    return body, moved @ body.placement[:3, :3].T + body.placement[:3, 3]
