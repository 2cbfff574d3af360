"""Reading files that may be huge, compressed or hostile: bounded bytes, text, and the limits of the scene readers."""

from __future__ import annotations

import gc
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from vitruvian.errors import FileError, warn

_MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Limits:
    """What a scene file may ask for. The defaults keep a hostile file under 5 s and 1 GB.

    `bytes` of the file and of what it unpacks to; `ratio` of unpacked to packed; `nodes`, USEs included; `entries`:
    nodes, fields, comments, routes together; `depth` of nesting; `protos`: prototypes inside prototypes; `expansion`:
    nodes when every USE is replaced by what it names.
    """

    bytes: int = 128 * _MIB
    ratio: int = 200
    nodes: int = 100_000
    entries: int = 500_000
    depth: int = 512
    protos: int = 32
    expansion: int = 4_000_000


LIMITS = Limits()


def read_bytes(path: str | os.PathLike[str], limits: Limits = LIMITS) -> bytes:
    """The content of a file, unpacked when it is gzip. FileError when it can't be read or is beyond the limits."""
    try:
        if not Path(path).is_file():
            raise FileError(path, 0, "is not a file" if Path(path).exists() else "no such file")
        with open(path, "rb") as file:
            data = file.read(limits.bytes + 1)
    except OSError as error:
        raise FileError(path, 0, f"can't be read: {error.strerror or error}") from None
    if len(data) > limits.bytes:
        raise FileError(path, 0, f"is larger than {limits.bytes // _MIB} MiB")
    return _unpack(path, data, limits) if data[:2] == b"\x1f\x8b" else data


def _unpack(path: object, data: bytes, limits: Limits) -> bytes:
    allowed = min(limits.bytes, max(limits.ratio * len(data), _MIB))
    unpacker = zlib.decompressobj(wbits=31)
    try:
        text = unpacker.decompress(data, allowed + 1)
    except zlib.error as error:
        raise FileError(path, 0, f"is broken gzip data: {error}") from None
    if len(text) > allowed:
        raise FileError(path, 0, f"unpacks to more than {allowed // _MIB} MiB; unpack it by hand if that is meant")
    if not unpacker.eof:
        raise FileError(path, 0, "is gzip data that ends too early")
    return text


@contextmanager
def no_collection() -> Iterator[None]:
    """Keep the cyclic garbage collector from walking a growing graph again and again."""
    running = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if running:
            gc.enable()


def refuse_crowds(path: object, text: str | bytes, mark: str | bytes, most: int, what: str) -> None:
    """FileError, before anything is parsed, when `mark`, with which each node begins, occurs too often."""
    if text.count(mark) <= most:  # type: ignore[arg-type]
        return
    place = -1
    for _ in range(most + 1):
        place = text.find(mark, place + 1)  # type: ignore[arg-type]
    newline = "\n" if isinstance(text, str) else b"\n"
    raise FileError(path, text.count(newline, 0, place) + 1, f"more than {most} {what}")  # type: ignore[arg-type]


def decode(path: object, data: bytes) -> str:
    """Text of UTF-8 bytes, line ends as \\n, no byte order mark; what isn't UTF-8 is read as Latin-1 with a warning."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    else:
        encoding = "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding == "utf-16":
            raise FileError(path, 0, "starts like UTF-16 text but isn't") from None
        line = data.count(b"\n", 0, error.start) + 1
        warn(f"{path}:{line}: not UTF-8; read as Latin-1")
        text = data.decode("latin-1")
    place = text.find("\0")
    if place >= 0:
        raise FileError(path, text.count("\n", 0, place) + 1, "holds a NUL byte: not a text file")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text
