"""What can go wrong, said in one line.

`FileError` is the only exception that readers raise about the content of a file; it carries the path and the line.
Things that are read with a browser's meaning although they are wrong become a `VitruvianWarning`.
"""

from __future__ import annotations

import warnings


class VitruvianError(Exception):
    """A request that can't be met; the message is one line that says what was expected and what to do."""


class FileError(VitruvianError):
    """Something in a file can't be read.

    Attributes: `path` (str), `line` (1-based, 0 when it is not about a line), `what` (one line of text), `partial`: the
    scene graph up to that line where a scene's syntax is broken, for those who say what is wrong (None elsewhere).
    """

    partial: object = None

    def __init__(self, path: object, line: int, what: str):
        what = " ".join(what[:1000].split())  # a name in a hostile file may be a megabyte long
        self.path, self.line, self.what = str(path), int(line), what if len(what) <= 300 else what[:297] + "..."
        where = f"{self.path}:{self.line}" if self.line else self.path
        super().__init__(f"{where}: {self.what}")


class MissingExtra(VitruvianError):
    """An optional dependency is not installed; the message says what to install."""

    def __init__(self, extra: str, purpose: str):
        super().__init__(f"{purpose} needs an extra: pip install 'vitruvian[{extra}]'")


class VitruvianWarning(UserWarning):
    """Something was wrong but has one accepted meaning, which was used."""


def warn(message: str) -> None:
    """Say one line to whoever listens (the command line prints it after `warning:`)."""
    warnings.warn(message, VitruvianWarning, stacklevel=3)
