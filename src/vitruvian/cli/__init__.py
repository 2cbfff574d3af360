"""The command line: one function per command, loaded when it is called.

Exit status: 0 done, 1 done but the answer is no, 2 bad usage or unreadable input (one line that starts with `error:`).
"""

from __future__ import annotations

import os
import sys
import warnings

import typer

from vitruvian.errors import VitruvianError, VitruvianWarning

INTERRUPTED = "interrupted; no file was left half written"

app = typer.Typer(
    name="vitruvian",
    help="Build, deform and animate virtual humans that comply with H-Anim (ISO/IEC 19774).",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from vitruvian import __version__

        print(f"vitruvian {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Build, deform and animate virtual humans that comply with H-Anim (ISO/IEC 19774)."""


from vitruvian.cli import (  # noqa: E402, F401  (they register their commands)
    blending,
    contouring,
    demo,
    desk,
    dressing,
    editing,
    fabrics,
    files,
    fitting,
    measuring,
    patterns,
    people,
    quality,
    reusing,
    showing,
    solving,
    surfaces,
)


def _say_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    if issubclass(category, VitruvianWarning):
        print(f"warning: {' '.join(str(message).split())}", file=sys.stderr)


def main() -> None:
    """Entry point: errors become one line and a status."""
    warnings.simplefilter("ignore")
    warnings.simplefilter("always", VitruvianWarning)
    warnings.showwarning = _say_warning
    try:
        status = app(standalone_mode=False)
    except KeyboardInterrupt:
        _fail(INTERRUPTED, 130)
    except VitruvianError as e:
        _fail(str(e), 2)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except OSError as e:
        _fail(f"{e.filename or ''}: {e.strerror or e}".removeprefix(": "), 2)
    except MemoryError:
        _fail("out of memory; the input is too large for this machine", 2)
    except Exception as e:
        if hasattr(e, "format_message"):  # a usage error of the command-line library
            _fail(f"{e.format_message()} (try --help)", 2)
        if type(e).__name__ == "Abort":
            _fail(INTERRUPTED, 130)
        if os.environ.get("VITRUVIAN_TRACEBACK"):
            raise
        _fail(f"internal: {type(e).__name__}: {e} (set VITRUVIAN_TRACEBACK=1 to see where, and please report it)", 2)
    if status == 130:  # the command-line library turns an interrupt into this status
        _fail(INTERRUPTED, 130)
    sys.exit(status if isinstance(status, int) else 0)


def _fail(message: str, status: int) -> None:
    print("error: " + " ".join(message.split()), file=sys.stderr)
    sys.exit(status)
