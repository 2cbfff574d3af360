"""Work behind a page on the scan that it shows, beside the frames: feature points found by themselves, girths taken.

One piece of work at a time, on a thread of its own; pages hear how far it is, and may stop it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from vitruvian.errors import VitruvianError
from vitruvian.stage.clip import Mesh

Progress = Callable[[int, int], None]


class _Stopped(Exception):
    pass


class Search:
    """What is being worked on. `told` is what pages hear, `version` counts its changes."""

    def __init__(self) -> None:
        self.version = 0
        self.told: dict[str, Any] = {}
        self._run: threading.Thread | None = None
        self._stop = threading.Event()
        self._lock = threading.Lock()

    def apply(self, request: Mapping[str, Any], mesh: Mesh) -> None:
        """Do what `find_landmarks`, `take_girths` or `stop_search` asks for; VitruvianError while something runs."""
        kind, name = request["type"], request["actor"]
        if kind == "stop_search":
            self._stop.set()
            return
        if self._run is not None and self._run.is_alive():
            raise VitruvianError(f"request {kind}: expected nothing under way; stop it, or wait")
        self._stop.clear()
        if kind == "find_landmarks":
            self._begin("found", name, lambda told: _found(mesh, told))
        else:
            points = dict(request["points"])
            self._begin("girths", name, lambda told: _girths(mesh, points, told))

    def wait(self) -> None:
        """Until nothing is under way."""
        if self._run is not None:
            self._run.join()

    def _begin(self, kind: str, actor: str, work: Callable[[Progress], dict[str, Any]]) -> None:
        def progress(done: int, total: int) -> None:
            if self._stop.is_set():
                raise _Stopped
            self._tell({"what": kind, "actor": actor, "done": done, "total": total})

        def run() -> None:
            end: dict[str, Any] = {"what": kind, "actor": actor}
            try:
                progress(0, 1)
                end |= work(progress)
                if self._stop.is_set():
                    end = {"what": kind, "actor": actor, "stopped": True}
            except _Stopped:
                end["stopped"] = True
            except VitruvianError as error:
                end["error"] = str(error)[:300]
            except Exception as error:  # the page has to hear that nothing will come
                end["error"] = f"internal: {type(error).__name__}: {error}"[:300]
            self._tell(end | {"ready": True})

        self._run = threading.Thread(target=run, name="search", daemon=True)
        self._run.start()

    def _tell(self, what: dict[str, Any]) -> None:
        with self._lock:
            self.told, self.version = what, self.version + 1


def _found(mesh: Mesh, progress: Progress) -> dict[str, Any]:
    from vitruvian.modeling.landmarks import detect

    points = detect(mesh, progress=progress)
    return {"points": {n: [*(float(x) for x in p), float(c)] for n, (p, c) in points.items()}}


def _girths(mesh: Mesh, points: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    from vitruvian.modeling.tapes import tapes

    found = tapes(mesh, points)
    return {"girths": {n: {"m": t.length, "points": t.points.tolist()} for n, t in found.items()}}
