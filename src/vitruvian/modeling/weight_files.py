"""Skin weights as files: CSV (`vertex,joint,weight`, joints by name) and npz (row, joint, weight, names).

The page's Weights panel saves the CSV; vertices are numbered as in the packed body, which for a seamless skin is as in
the file. `stored` puts weights into the Humanoid they belong to.
"""

from __future__ import annotations

import csv
import io
import os
import zipfile
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np

from vitruvian.body.types import Body, Weights
from vitruvian.errors import FileError, VitruvianError
from vitruvian.hanim.humanoid import Humanoid

HEADER = ("vertex", "joint", "weight")
MAX_BYTES = 1 << 28
MOST = 1e6  # the largest weight that makes sense


def save_weights(body: Body, path: str | os.PathLike[str]) -> None:
    """Write the weights of a body as .csv or .npz; a failed call leaves an older file as it was."""
    target, w, names = Path(path), body.skin.weights, body.skeleton.names
    data = io.BytesIO()
    if target.suffix.lower() == ".npz":
        np.savez_compressed(data, row=w.row, joint=w.joint, weight=w.weight, names=np.array(names, dtype=np.str_))
    elif target.suffix.lower() == ".csv":
        text = io.StringIO()
        out = csv.writer(text, lineterminator="\n")
        out.writerow(HEADER)
        rows = zip(w.vertex.tolist(), w.joint.tolist(), w.weight.tolist(), strict=True)
        out.writerows((v, names[j], repr(x)) for v, j, x in rows)
        data.write(text.getvalue().encode())
    else:
        raise VitruvianError(f"{target}: expected .csv or .npz for weights")
    part = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        part.write_bytes(data.getvalue())
        part.replace(target)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise VitruvianError(f"{target}: can't be written ({error.strerror})") from None


def read_weights(path: str | os.PathLike[str], body: Body) -> Weights:
    """Weights for a body out of a .csv or .npz file, its joints by name.

    Raises FileError with the line for anything else, for joints and vertices that the body does not have, and for
    weights that are not 0 or more.
    """
    source = Path(path)
    try:
        size = source.stat().st_size
        if size > MAX_BYTES:
            raise FileError(path, 0, f"expected weights of at most {MAX_BYTES >> 20} MB, found {size >> 20}")
        if source.suffix.lower() == ".npz":
            return _npz(source, body)
        if source.suffix.lower() != ".csv":
            raise FileError(path, 0, "expected .csv or .npz for weights")
        with source.open(encoding="utf-8-sig", newline="") as lines:
            return rows_of(lines, body, source)
    except OSError as error:
        raise FileError(path, 0, f"can't be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise FileError(path, 0, "expected text in UTF-8, found other bytes") from None


def rows_of(lines: Iterable[str], body: Body, path: object = "weights") -> Weights:
    """Weights out of lines of CSV."""
    count, index = len(body.skin.rest), body.skeleton.index
    reader = csv.reader(lines)
    vertex: list[int] = []
    joint: list[int] = []
    weight: list[float] = []
    try:
        head = next(reader, [])
        if [h.strip().lower() for h in head] != list(HEADER):
            raise FileError(path, 1, f"expected the header {','.join(HEADER)}, found {','.join(head)[:60]!r}")
        for row in reader:
            if not row:
                continue
            at = reader.line_num
            if len(row) != 3:
                raise FileError(path, at, f"expected vertex,joint,weight, found {len(row)} fields")
            try:
                v, w = int(row[0]), float(row[2])
            except ValueError:
                raise FileError(
                    path, at, f"expected a whole number and a weight, found {','.join(row)[:60]!r}"
                ) from None
            if not 0 <= v < count:
                raise FileError(path, at, f"vertex {v}: the body has 0..{count - 1}")
            if row[1] not in index:
                raise FileError(path, at, f"joint {row[1][:60]!r}: the body has none of that name")
            if not 0 <= w <= MOST:
                raise FileError(path, at, f"weight {row[2][:30]}: expected 0 or more")
            vertex.append(v)
            joint.append(index[row[1]])
            weight.append(w)
    except csv.Error as error:
        raise FileError(path, reader.line_num, f"expected CSV, found something else ({error})") from None
    return Weights.from_pairs(count, vertex, joint, weight)


def _npz(path: Path, body: Body) -> Weights:
    try:
        with np.load(path, allow_pickle=False) as file:
            with zipfile.ZipFile(path) as box:
                if sum(i.file_size for i in box.infolist()) > 4 * MAX_BYTES:
                    raise FileError(path, 0, "expected weights, found an archive that unpacks to far more")
            row, joint, weight, names = (np.asarray(file[k]) for k in ("row", "joint", "weight", "names"))
    except FileError:
        raise
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile, NotImplementedError) as error:
        raise FileError(path, 0, f"expected npz with row, joint, weight, names ({str(error)[:80]})") from None
    if (
        row.ndim != 1
        or joint.ndim != 1
        or names.ndim != 1
        or row.dtype.kind not in "iu"
        or joint.dtype.kind not in "iu"
    ):
        raise FileError(path, 0, "expected whole numbers in row and joint")
    if weight.dtype.kind != "f" or names.dtype.kind != "U":
        raise FileError(path, 0, "expected numbers in weight and text in names")
    count = len(body.skin.rest)
    if len(row) != count + 1:
        raise FileError(path, 0, f"expected {count} vertices, found {len(row) - 1}")
    unknown = [n for n in islice(names.tolist(), 10000) if n not in body.skeleton.index]
    if unknown:
        raise FileError(path, 0, f"joint {unknown[0][:60]!r}: the body has none of that name")
    try:
        if joint.size and not (int(joint.min()) >= 0 and int(joint.max()) < len(names)):
            raise VitruvianError(f"joint: expected numbers in 0..{len(names) - 1}")
        own = np.array([body.skeleton.index[n] for n in names.tolist()], np.int32)
        found = Weights(row, own[joint.astype(np.int64)] if joint.size else joint, weight)
    except VitruvianError as error:
        raise FileError(path, 0, str(error)) from None
    return Weights.from_pairs(count, found.vertex, found.joint, found.weight)


def stored(humanoid: Humanoid, weights: Weights) -> Humanoid:
    """The humanoid (changed in place) with these weights, numbered as `pack(humanoid)` does.

    Raises VitruvianError when they are for another body, or change points that a Segment or contours carry, whose joint
    is where they hang in the tree: those first become a skin with `vitruvian.weld`.
    """
    from vitruvian.body.pack import pack

    body = pack(humanoid)
    now, names, count = body.skin.weights, body.skeleton.names, len(humanoid.skin_coord)
    if len(weights) != len(now):
        raise VitruvianError(f"weights: expected {len(now)} vertices as the body has, found {len(weights)}")
    if not any(len(j.skin_coord_index) for j in humanoid.joints()) and not any(s.points is None for s in humanoid.skin):
        count = 0
    fixed = [(w.vertex[w.row[count] :], w.joint[w.row[count] :], w.weight[w.row[count] :]) for w in (now, weights)]
    if not all(np.array_equal(a, b) if k < 2 else len(a) == len(b) and np.allclose(a, b, atol=1e-6)
               for k, (a, b) in enumerate(zip(*fixed, strict=True))):  # fmt: skip
        raise VitruvianError(
            f"weights: vertices from {count} on belong to Segments or contours, which follow one joint"
        )
    end = int(weights.row[count])
    vertex, owner, value = weights.vertex[:end], weights.joint[:end], weights.weight[:end]
    given = {names[j]: (vertex[owner == j], value[owner == j]) for j in np.unique(owner).tolist()}
    for joint in humanoid.joints():
        index, weight = given.get(joint.name, (np.zeros(0, np.int32), np.zeros(0)))
        joint.skin_coord_index, joint.skin_coord_weight = index.astype(np.int32), weight.copy()
    return humanoid
