"""The command about drawing patterns: pattern edit."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli.output import Json, Repair, emit
from vitruvian.cli.patterns import pattern
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.cloth.pattern import Pattern
    from vitruvian.show.editing import Editing

NEW = "new"


@pattern.command(epilog="Example: vitruvian pattern edit tshirt --save mine.pattern.json")
def edit(
    source: Path = typer.Argument(Path(NEW), metavar="[PATTERN]", help="A pattern's file, a draft (see list), or new."),
    body: str = typer.Option("person", "--body", help="H-Anim, glTF, VRM or USD body, or the word person."),
    save: Path | None = typer.Option(
        None, "--save", help="Where the page saves: NAME.pattern.json, or another format of patterns."
    ),
    no_open: bool = typer.Option(False, "--no-open", help="Print the address without opening a browser."),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Draw a pattern in the browser, sew it and see it worn, until Ctrl-C.

    Nothing is written until you save. What is not saved when the page, the command or the machine stops is there again
    when the same pattern is opened.
    """
    import sys
    import threading
    import webbrowser
    from contextlib import suppress

    from vitruvian.show.live import Window, serve
    from vitruvian.show.server import Server

    server = Server(desk_of(source, body, save, repair=repair))
    window = Window(server, serve(server))
    if not no_open:
        webbrowser.open(window.url)
    with window, suppress(KeyboardInterrupt):
        emit({"address": window.url}, f"{window.url}  (Ctrl-C ends it)", as_json)
        sys.stdout.flush()
        threading.Event().wait()


def desk_of(source: Path, body: str, save: Path | None, *, repair: bool = False) -> Editing:
    """A pattern on the desk, for a body, with what was not saved last time."""
    from vitruvian.body.pack import pack
    from vitruvian.cli.dressing import _bare, pattern_of
    from vitruvian.cloth.dimensions import fitted
    from vitruvian.formats.pattern_file import write_any
    from vitruvian.modeling.measures import measures
    from vitruvian.show.editing import EMPTY, Editing

    if save is not None:
        _writable(save)
    figure = _bare(body, repair)
    if str(source) == NEW and not source.exists():
        start: Any = EMPTY
        if save is not None and save.exists():
            start = pattern_of(save, figure)
    else:
        start = pattern_of(source, figure)
    known = measures(figure).values
    if start is not EMPTY:
        start = _standing(fitted(start, known), figure)  # what is said by measures of a body is said of this one
    if save is None and source.name.lower().endswith(".pattern.json"):
        save = source
    draft = _draft(save or source)
    write = None
    if save is not None:
        write = lambda made: write_any(made, save)  # noqa: E731
    return Editing(
        start,
        pack(figure),
        measures=known,
        where="" if save is None else save.name,
        save=write,
        exports=exports(),
        keep=lambda text: _kept(draft, text),
        recovered=_read(draft),
    )


def _standing(found: Pattern, body: Any) -> Pattern:
    """With places for panels that have none, where it can be told; others are placed in the page."""
    from vitruvian.cli.dressing import placed_on

    try:
        return placed_on(found, body)
    except VitruvianError:
        return found


def exports() -> dict[str, Any]:
    """What a page may download: format -> bytes of a pattern."""
    from vitruvian.formats.pattern_file import WRITERS

    return {ending.removeprefix("."): _export(ending) for ending in WRITERS}


def _export(ending: str) -> Any:
    def made(found: Pattern) -> bytes:
        import tempfile

        from vitruvian.formats.pattern_file import write_any

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"pattern{ending}"
            write_any(found, path)
            return path.read_bytes()

    return made


def _writable(path: Path) -> None:
    from vitruvian.formats.pattern_file import WRITERS

    if not path.name.lower().endswith(tuple(WRITERS)):
        raise VitruvianError(f"--save {path}: expected a name that ends in {', '.join(WRITERS)}")


def _draft(path: Path) -> Path:
    """Where unsaved work on a file is kept: in the user's own folder of states, not beside the file."""
    home = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    key = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:20]
    return home / "vitruvian" / "patterns" / f"{key}.json"


def _kept(draft: Path, text: str) -> None:
    from vitruvian.formats.atomic import atomic

    try:
        if not text:
            draft.unlink(missing_ok=True)
            return
        draft.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with atomic(draft) as temporary:
            Path(temporary).write_text(text, encoding="utf-8")
    except OSError:  # a home that cannot be written to: the page itself keeps it as long as it is open
        return


def _read(draft: Path) -> str:
    import json

    try:
        text = draft.read_text(encoding="utf-8")
        return text if isinstance(json.loads(text), dict) else ""
    except (OSError, ValueError, RecursionError):
        return ""
