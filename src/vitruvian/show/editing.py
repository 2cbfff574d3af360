"""A pattern on the desk: what the page of the pattern editor knows and may ask for.

The page holds the document (as `formats.pattern_file` writes it) and changes it; Python reads it back, lets the doctor look
at it, proposes seams, drapes it, and saves it where the desk was opened to save it. A page never names a file.
"""

from __future__ import annotations

import atexit
import json
import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Ints
from vitruvian.cloth.doctor import RULES, examined
from vitruvian.cloth.drafting.figure import figure
from vitruvian.cloth.fabric import FABRICS
from vitruvian.cloth.garment import Garment
from vitruvian.cloth.pattern import Pattern
from vitruvian.cloth.placing import Dummy, dummy
from vitruvian.cloth.proposals import proposals
from vitruvian.cloth.sheet import strains
from vitruvian.cloth.tailor import COARSE, tailor
from vitruvian.cloth.tessellate import tessellate
from vitruvian.cloth.wrapping import stand, wrapped
from vitruvian.errors import VitruvianError
from vitruvian.formats.pattern_file import document, pattern_from
from vitruvian.show.striding import Stride
from vitruvian.show.wire import VERSION, Block, encode, quantise

MAX_TEXT = 8 << 20  # characters of a document that a page may send
MAX_FINDINGS = 300
PATIENCE = 5.0  # seconds for a thread to end
LOOK = 0.12  # seconds between two pictures of cloth that falls
# What the page may ask for, see `wire.parse_request`.
REQUESTS: dict[str, dict[str, tuple[str, float, float]]] = {
    "hello": {"token": ("text", 0, 64), "version": ("whole", 0, 1000)},
    "pattern": {"seq": ("whole", 0, 2**53), "text": ("text", 0, 24000), "last": ("flag", 0, 1)},
    "propose": {},
    "place": {"panel": ("text", 0, 200), "words": ("text", 0, 100)},
    "drape": {"fabric": ("text", 0, 40), "size": ("number", 0.003, 0.05)},
    "walk": {},
    "stop": {},
    "save": {},
    "export": {"format": ("text", 0, 20)},
}
EMPTY: Mapping[str, Any] = {"vitruvian_pattern": 1, "name": "pattern", "panels": [], "seams": [], "buttons": []}


class Stopped(Exception):
    """Somebody does not want to wait for a drape."""


class Editing:
    """A pattern, the body that it is made for, and where it is saved.

    start: the document to begin with, `EMPTY` for none. measures: of the body, metres. where: the words by which people
    know the file that `save(pattern)` writes, "" when there is none. exports: {format: pattern -> bytes} that a page may
    download. keep(text) is told every document that is not saved, and "" once it is. `wake` is called when `outbox` has
    something to send, `taken` when another page takes over.
    """

    requests = REQUESTS

    def __init__(
        self,
        start: Mapping[str, Any] | Pattern,
        body: Body,
        *,
        measures: Mapping[str, float] | None = None,
        where: str = "",
        save: Callable[[Pattern], object] | None = None,
        exports: Mapping[str, Callable[[Pattern], bytes]] | None = None,
        keep: Callable[[str], None] = lambda _: None,
        recovered: str = "",
    ):
        first = document(start) if isinstance(start, Pattern) else dict(start)
        self.saved = json.dumps(first)
        self.text = recovered or self.saved
        self.recovered = bool(recovered)
        self.body, self.measures = body, dict(measures or {})
        self.where, self._save, self._exports, self._keep = where, save, dict(exports or {}), keep
        self.wake: Callable[[], None] = lambda: None
        self.taken: Callable[[], None] = lambda: None
        self._pieces: list[str] = []
        self._seq = 0
        self._told: dict[str, bytes] = {}  # the newest message of each kind that waits to be sent
        self._lock = threading.Lock()
        self._drape: _Drape | None = None
        self._stride: Stride | None = None
        self._dummy: Dummy | None = None
        atexit.register(self.close)  # threads in the kernels must not outlive the interpreter

    @property
    def dummy(self) -> Dummy:
        """The body in the pose that clothes are sewn on."""
        if self._dummy is None:
            self._dummy = dummy(self.body)
        return self._dummy

    def pattern(self) -> Pattern:
        """What is on the desk. VitruvianError in one line where it is none."""
        return pattern_from(json.loads(self.text), "pattern")

    def hello(self) -> list[bytes]:
        """What a page hears first: the document, and the body."""
        fields: dict[str, Any] = {
            "version": VERSION,
            "document": json.loads(self.text),
            "seq": self._seq,
            "saved": self.text == self.saved,
            "recovered": self.recovered,
            "where": self.where,
            "measures": self.measures,
            "fabrics": list(FABRICS),
            "formats": list(self._exports),
            "rules": RULES,
        }
        return [encode("hello", fields), self._body(), self._findings()]

    def outbox(self) -> list[bytes]:
        """Messages that wait; of each kind only the newest."""
        with self._lock:
            out = list(self._told.values())
            self._told.clear()
        return out

    def tell(self, kind: str, message: bytes) -> None:
        """Put a message into the outbox; from any thread."""
        with self._lock:
            self._told.pop(kind, None)
            self._told[kind] = message
        self.wake()

    def apply(self, request: Mapping[str, Any]) -> bytes | None:
        """Do what the page asks for; what to answer. VitruvianError says why not."""
        kind = request["type"]
        if kind == "pattern":
            return self._take(request)
        if kind == "propose":
            return self._proposals()
        if kind == "place":
            return self._placed(request["panel"], request["words"])
        if kind == "drape":
            self.stop()
            self._drape = _Drape(self, self.pattern(), request["fabric"], request["size"])
        elif kind == "walk":
            done = None if self._drape is None else self._drape.made
            if done is None:
                raise VitruvianError("walk: drape the pattern first")
            self.stop()
            self._stride = Stride(self.body, done, self._hear_stride, self._hang)
        elif kind == "stop":
            self.stop()
        elif kind == "save":
            if self._save is None:
                raise VitruvianError("no file to save in: start with --save FILE, or download it")
            self._save(self.pattern())
            self.saved, self.recovered = self.text, False
            self._keep("")
            return encode("saved", {"where": self.where, "seq": self._seq})
        elif kind == "export":
            write = self._exports.get(request["format"])
            if write is None:
                raise VitruvianError(f"export: expected one of {', '.join(self._exports)}")
            data = np.frombuffer(write(self.pattern()), np.uint8)
            return encode("file", {"format": request["format"]}, [Block("data", data)])
        return None

    def stop(self) -> None:
        """End the drape or the walk that runs, if any; they say so themselves."""
        if self._drape is not None:
            self._drape.stop()
        if self._stride is not None:
            self._stride.stop()

    def close(self) -> None:
        """End what runs, and wait for it."""
        self.stop()
        for one in (self._drape, self._stride):
            if one is not None:
                one.thread.join(PATIENCE)

    def _hear_stride(self, kind: str, fields: dict[str, Any], blocks: list[Block]) -> None:
        self.tell(kind, encode(kind, fields, blocks))

    def _hang(self) -> None:
        """Body and garment stand still again, as they were draped."""
        drape = self._drape
        if drape is None or drape.made is None:
            return
        self.tell("body", self._body())
        self.tell("fall", drape.hung())

    def _body(self) -> bytes:
        shown = self.dummy
        blocks = [
            Block("vertices", shown.vertices.astype(np.float32)),
            Block("triangles", shown.triangles.astype(np.uint32)),
        ]
        return encode("body", {}, blocks)

    def _take(self, request: Mapping[str, Any]) -> bytes | None:
        self._pieces.append(request["text"])
        if sum(map(len, self._pieces)) > MAX_TEXT:
            self._pieces.clear()
            raise VitruvianError(f"request pattern: expected at most {MAX_TEXT >> 20} MB")
        if not request["last"]:
            return None
        text = "".join(self._pieces)
        self._pieces.clear()
        try:
            fine = isinstance(json.loads(text), dict)
        except (ValueError, RecursionError):
            fine = False
        if not fine:
            raise VitruvianError("request pattern: expected a document")
        self.text, self._seq = text, request["seq"]
        self._keep("" if text == self.saved else text)
        return self._findings()

    def _findings(self) -> bytes:
        """What the doctor says of it; of a document that is no pattern, why not."""
        fields: dict[str, Any] = {"seq": self._seq, "findings": [], "problem": ""}
        if json.loads(self.text).get("panels"):
            try:
                fields["findings"] = [asdict(f) for f in examined(self.pattern())[:MAX_FINDINGS]]
            except VitruvianError as error:
                fields["problem"] = str(error)
            except Exception as error:  # a page that is thrown out would send the same again
                logging.getLogger(__name__).exception("the doctor failed")
                fields["problem"] = f"the doctor failed: {type(error).__name__}: {error}"[:300]
        return encode("findings", fields)

    def _placed(self, name: str, words: str) -> bytes:
        """Where a panel goes that is worn where `words` say, such as "torso front left"."""
        found = next((p for p in self.pattern().panels if p.name == name), None)
        if found is None:
            raise VitruvianError(f"place: there is no panel {name!r:.60}")
        bare = replace(found, rotation=None, translation=None)
        alone = Pattern("pattern", (bare,), extra={"wrap": {name: words}})
        panel = wrapped(alone, stand(figure(self.measures), self.dummy)).panel(name)
        assert panel.rotation is not None and panel.translation is not None
        place = {"rotation": panel.rotation.tolist(), "translation": panel.translation.tolist()}
        return encode("placed", {"panel": name, "labels": [e.label for e in panel.edges]} | place)

    def _proposals(self) -> bytes:
        found = proposals(self.pattern())
        side = lambda spans: [[s.panel, s.edge, s.t0, s.t1] for s in spans]  # noqa: E731
        said = [
            {
                "seam": {
                    "a": side(p.seam.a),
                    "b": side(p.seam.b),
                    "reversed": p.seam.reversed,
                    "kind": p.seam.kind,
                    "open": p.seam.open,
                },
                "score": p.score,
                "reason": p.reason,
            }
            for p in found
        ]
        return encode("proposals", {"proposals": said, "seq": self._seq})


class _Drape:
    """A garment that is being tailored in a thread of its own."""

    def __init__(self, desk: Editing, pattern: Pattern, fabric: str, size: float):
        self.desk, self.pattern, self.fabric, self.size = desk, pattern, fabric, size
        self.seq, self.stopping = desk._seq, threading.Event()
        self.what, self.share, self.looked = "meshing", 0.0, 0.0
        self.made: Garment | None = None
        self.thread = threading.Thread(target=self._run, name="vitruvian drape", daemon=True)
        self.thread.start()

    def stop(self) -> None:
        self.stopping.set()

    def _run(self) -> None:
        self._tell("drape", {"state": "falling"})
        try:
            # of each triangle, welded or not, by how many there are: fine cloth begins as coarse cloth
            meshes = [
                tessellate(self.pattern, s) for s in {self.size, 2 * self.size if self.size <= COARSE else self.size}
            ]
            self.panels = {len(m.triangles): m.panel[m.triangles[:, 0]].astype(np.uint16) for m in meshes}
            made = tailor(
                self.pattern, self.desk.body, fabric=self.fabric, size=self.size, progress=self._hear, watch=self._see
            )
            self.made = made
            self._tell("drape", {"state": "done", "report": dict(made.report)}, self._worn(made))
        except Stopped:
            self._tell("drape", {"state": "stopped"})
        except VitruvianError as error:
            self._tell("drape", {"state": "failed", "message": str(error)})
        except Exception as error:  # nobody else would ever hear of it
            logging.getLogger(__name__).exception("the drape failed")
            self._tell("drape", {"state": "failed", "message": f"{type(error).__name__}: {error}"[:300]})

    def _hear(self, what: str, share: float) -> None:
        if self.stopping.is_set():
            raise Stopped
        self.what, self.share = what, share

    def _see(self, positions: NDArray[np.floating], triangles: Ints) -> None:
        if self.stopping.is_set():
            raise Stopped
        if time.monotonic() - self.looked > LOOK:
            self._tell("fall", {}, self._surface(positions, triangles))
            self.looked = time.monotonic()

    def _tell(self, kind: str, fields: dict[str, Any], blocks: list[Block] | None = None) -> None:
        state = {"seq": self.seq, "what": self.what, "share": self.share}
        self.desk.tell(kind, encode(kind, state | fields, blocks or []))

    def hung(self) -> bytes:
        """The message of the garment as it hangs."""
        assert self.made is not None
        state = {"seq": self.seq, "what": self.what, "share": self.share}
        return encode("fall", state, self._worn(self.made))

    def _surface(self, positions: NDArray[np.floating], triangles: Ints) -> list[Block]:
        q, scale, origin = quantise(positions)
        flat = triangles.astype(np.uint32)
        return [
            Block("vertices", q, "", scale, origin),
            Block("triangles", flat),
            Block("panel", self.panels[len(flat)]),
        ]

    def _worn(self, made: Garment) -> list[Block]:
        """The garment as it hangs, and how much it is stretched at each vertex."""
        long = strains(made.sheet, made.vertices).reshape(3, -1).max(axis=0)
        most = np.zeros(len(made.vertices))
        np.add.at(most, made.triangles.ravel(), np.repeat(np.maximum(long, 0), 3))
        most /= np.maximum(np.bincount(made.triangles.ravel(), minlength=len(most)), 1)
        return [*self._surface(made.vertices, made.triangles), Block("strain", most.astype(np.float32))]
