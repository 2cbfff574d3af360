"""Files that are either complete or not there."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vitruvian.errors import VitruvianError


@contextmanager
def atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path in the folder of `path` that takes its name when the block ends well.

    The temporary keeps the ending of `path`, so that writers which choose a format by it do the same. After any
    exception it is removed and an older file at `path` stays as it was. The folder must exist.
    """
    target = Path(path)
    folder = target.parent
    if not folder.is_dir():
        raise VitruvianError(f"{target}: the folder {folder} does not exist; make it first")
    if target.is_dir():
        raise VitruvianError(f"{target}: is a folder; give the name of a file")
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.stem[:40]}-", suffix=target.suffix, dir=folder)
    except OSError as error:
        raise VitruvianError(f"{target}: can't write in {folder} ({error.strerror})") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
