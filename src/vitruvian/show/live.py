"""Open the page on things that live in this process."""

from __future__ import annotations

import contextlib
import threading
import time
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from typing import TYPE_CHECKING, Any

from vitruvian.errors import VitruvianError
from vitruvian.show.actors import actors_of, actors_on
from vitruvian.stage.stage import Stage

if TYPE_CHECKING:
    from vitruvian.show.keeping import Keeping
    from vitruvian.show.server import Server

LONGEST = 600  # characters of one field of a finding


class Window:
    """A page that is being served from another thread: `url`, and `close()`. A context manager too."""

    def __init__(self, server: Server, thread: threading.Thread):
        self._server, self._thread = server, thread
        self.url = server.url

    def close(self) -> None:
        """Stop serving; pages say that the connection is gone."""
        self._server.stop()
        self._thread.join(timeout=5)

    def __enter__(self) -> Window:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def show(
    *things: object,
    open_browser: bool = True,
    block: bool = True,
    findings: Sequence[object] = (),
    title: str = "",
    port: int = 0,
    compare: bool = False,
    keeping: Keeping | None = None,
) -> Window | None:
    """Show Clips, Humanoids, Bodies and Meshes in the browser, or a Stage of them.

    A Stage goes on living: what is sent to it while the page is open is seen there. `findings` (dataclasses or mappings
    with `rule severity where line message fix`, as the H-Anim doctor gives them) fill the page's list. `compare`: the
    page can compare the first figure with itself in contours. `keeping`: files that the page may save feature points and
    weights in. Prints the address. With `block` it returns after an
    interrupt (Ctrl-C), else at once with a `Window`. The server listens on the loopback interface only; `port` 0 takes a
    free one. Raises `VitruvianError`.
    """
    from vitruvian.show.server import Server, Showing

    stage = things[0] if len(things) == 1 and isinstance(things[0], Stage) else None
    actors = actors_of(things, compare=compare) if stage is None else actors_on(stage, compare=compare)
    server = Server(Showing(actors, [finding_fields(f) for f in findings], title, stage, keeping=keeping), port)
    if block:
        print(f"showing at {server.url}  (Ctrl-C ends it)", flush=True)
        if open_browser:
            threading.Timer(0.5, webbrowser.open, [server.url]).start()
        with contextlib.suppress(KeyboardInterrupt):
            server.run()
        return None
    window = Window(server, serve(server))
    if open_browser:
        webbrowser.open(server.url)
    return window


def serve(server: Server) -> threading.Thread:
    """Run a server in a thread of its own; returns when it answers."""
    thread = threading.Thread(target=server.run, name="vitruvian page", daemon=True)
    thread.start()
    for _ in range(500):
        if server.started:
            return thread
        time.sleep(0.01)
    raise VitruvianError("show: the local server did not start within 5 s")


def finding_fields(finding: object) -> Mapping[str, Any]:
    """The fields of a finding that the page lists, as plain JSON values."""
    raw = asdict(finding) if is_dataclass(finding) and not isinstance(finding, type) else finding
    if not isinstance(raw, Mapping):
        raise VitruvianError(f"findings: expected dataclasses or mappings, found {type(finding).__name__}")
    names = ("rule", "severity", "where", "line", "message", "fix")
    return {n: raw[n] if isinstance(raw[n], int) else str(raw[n])[:LONGEST] for n in names if raw.get(n) is not None}
