"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from vitruvian.errors import FileError


@contextmanager
def atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path in the folder of `path`: renamed onto it when the block succeeds, removed when it raises.

    The temporary name ends like `path`, for writers that go by the extension. FileError when the folder isn't writable.
    """
    target = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=".", suffix="." + target.name, dir=target.parent)
    except OSError as error:
        raise FileError(path, 0, f"can't be written: {error.strerror or error}") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes files that only their owner can read
        os.replace(temporary, target)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
