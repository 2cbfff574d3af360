"""The local server of the page: static files from a fixed table, and one WebSocket that streams poses.

It binds to the loopback interface only. Data flows only over the WebSocket, only after its first message carried the
token (128 bits, in the fragment of the address, which browsers do not send), and only from a page of our own origin:
`Host` and `Origin` are checked against the addresses that this server has. No message holds a path, code or an upload.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import hmac
import logging
import re
import secrets
import socket
import time
from collections import deque
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import VitruvianError
from vitruvian.show.actors import PAGE, SERVED, Actor, Vertices, able, mesh_messages, pose_blocks, sample, turned
from vitruvian.show.wire import MAX_REQUEST, VERSION, Block, encode, parse_request

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Receive, Scope, Send
    from starlette.websockets import WebSocket

FOLDER = Path(__file__).parent / "page"
MODULES = (
    "main.js",
    "wire.js",
    "source.js",
    "deform.js",
    "mesh.js",
    "contours.js",
    "hands.js",
    "operators.js",
    "skin.js",
    "sections.js",
    "gauge.js",
    "compare.js",
    "stripes.js",
    "detail.js",
    "pose.js",
    "figure.js",
    "looks.js",
    "studio.js",
    "overlays.js",
    "panels.js",
    "explorer.js",
    "level.js",
    "ranges.js",
    "details.js",
    "places.js",
    "shapes.js",
    "findings.js",
    "controls.js",
    "colors.js",
    "vendor/OrbitControls.js",
    "vendor/three.module.js",
    "vendor/three.core.js",
)
FILES = {"": "index.html", "style.css": "style.css", "boot.js": "boot.js"} | {name: name for name in MODULES}
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
}
MAX_PAGES = 8
IN_FLIGHT = 3  # frames sent and not yet acknowledged, per page
INTERVAL = 1 / 60  # seconds between frames
RATE = 200  # requests per second and page
STRIKES = 3  # bad requests until the connection is closed
MAX_FINDINGS = 1000  # that a page lists; how many there are it always says
PATIENCE = 5.0  # seconds for the first message


class Showing:
    """What is shown and where its clock stands. All pages of one showing see the same; any of them may drive."""

    def __init__(self, actors: Sequence[Actor], findings: Sequence[Mapping[str, Any]] = (), title: str = ""):
        self.actors = list(actors)
        self.by_name = {a.name: a for a in self.actors}
        self.findings = [dict(f) for f in findings]
        self.title = title or ", ".join(a.name for a in self.actors)
        self.fps = max(a.fps for a in self.actors)
        self.frames = max(1, round(max(len(a) / a.fps for a in self.actors) * self.fps))
        self.meshes = [m for a in self.actors for m in mesh_messages(a)]
        self.deformers = {a.name: a.deformer for a in self.actors if a.body is not None}
        self.turns: dict[str, dict[int, NDArray[np.float64]]] = {a.name: {} for a in self.actors}
        self.displaced: dict[str, dict[int, float]] = {a.name: {} for a in self.actors}
        self.vertices: dict[tuple[str, str], Vertices] = {}
        self.playing, self.loop, self.speed = self.frames > 1, True, 1.0
        self.change = 0  # counts everything that pages have to be told
        self._frame, self._since, self._round = 0.0, time.monotonic(), 0
        self.wake: set[asyncio.Event] = set()
        self.opened = False

    def begin(self) -> None:
        """Time starts to run when the first page looks."""
        if not self.opened:
            self.opened = True
            self._set(self._frame)

    def now(self) -> tuple[float, int]:
        """Frame (a fraction between frames) and completed rounds of the loop."""
        if not self.playing:
            return self._frame, self._round
        at = self._frame + (time.monotonic() - self._since) * self.speed * self.fps
        if not self.loop:
            if at >= self.frames - 1:
                self._set(self.frames - 1)
                self.playing = False
                self.change += 1
            return min(at, self.frames - 1.0), self._round
        rounds = int(at // self.frames)
        return at - rounds * self.frames, self._round + rounds

    def _set(self, frame: float, rounds: int | None = None) -> None:
        self._frame, self._since = min(max(frame, 0.0), self.frames - 1e-6), time.monotonic()
        self._round = self._round if rounds is None else rounds

    def apply(self, request: Mapping[str, Any]) -> None:
        """Do what a page asked for; `VitruvianError` for names that do not exist."""
        kind = request["type"]
        frame, rounds = self.now()
        if kind == "play":
            self._set(0.0 if not self.loop and frame >= self.frames - 1.5 else frame, rounds)
            self.playing = self.frames > 1
        elif kind == "pause":
            self._set(frame, rounds)
            self.playing = False
        elif kind == "seek":
            self._set(min(request["frame"], self.frames - 1.0), rounds)
        elif kind == "speed":
            self._set(frame, rounds)
            self.speed = float(request["value"])
        elif kind == "step":
            self.playing = False
            self._set((round(frame) + request["frames"]) % self.frames, rounds)
        elif kind == "loop":
            self._set(frame, rounds)
            self.loop = request["value"]
        else:
            self._edit(kind, request)
        self.change += 1
        for event in self.wake:
            event.set()

    def _edit(self, kind: str, request: Mapping[str, Any]) -> None:
        actor = self.by_name.get(request["actor"])
        if actor is None or actor.body is None:
            raise VitruvianError(f"request {kind}: expected an actor with joints, found {request['actor']!r:.60}")
        if kind == "clear_pose":
            self.turns[actor.name].clear()
            self.displaced[actor.name].clear()
        elif kind == "deformer":
            name = request["name"]
            if name not in PAGE + SERVED:
                raise VitruvianError(f"request deformer: expected one of {', '.join(PAGE + SERVED)}")
            if not able(actor.body, name):
                raise VitruvianError(f"request deformer: {actor.name} has nothing that {name!r} could move")
            if name in SERVED and (actor.name, name) not in self.vertices:
                try:
                    self.vertices[actor.name, name] = Vertices(actor, name)
                except (ImportError, ValueError) as error:
                    raise VitruvianError(f"deformer {name} is not available: {error}") from None
            self.deformers[actor.name] = name
        else:
            table = actor.joint_index if kind == "set_rotation" else actor.displacer_index
            name = request["joint"] if kind == "set_rotation" else request["name"]
            if name not in table:
                raise VitruvianError(f"request {kind}: {actor.name} has no {name!r:.60}")
            if kind == "clear_displacer":
                self.displaced[actor.name].pop(table[name], None)
            elif kind == "set_displacer":
                self.displaced[actor.name][table[name]] = float(request["weight"])
            else:
                self.turns[actor.name][table[name]] = np.asarray(request["rotation"], dtype=np.float64)

    def running(self) -> dict[str, Any]:
        """How time runs, as pages show it."""
        return {"playing": self.playing, "speed": self.speed, "loop": self.loop}

    def hello(self, deformers: Sequence[str] | None = None) -> bytes:
        """The first message. `deformers`: those that may be chosen; None: all that one of the bodies can take."""
        if deformers is None:
            bodies = [a.body for a in self.actors if a.body is not None]
            deformers = [*PAGE, *(name for name in SERVED if any(able(b, name) for b in bodies))]
        return encode(
            "hello",
            {
                "version": VERSION,
                "title": self.title,
                "actors": [a.name for a in self.actors],
                "frames": self.frames,
                "fps": self.fps,
                "findings": self.findings[:MAX_FINDINGS],
                "found": len(self.findings),
                "deformers": list(deformers),
            }
            | self.running(),
        )

    def frame(self, seq: int) -> bytes:
        """The message for this moment. Pose and vertices of one moment always travel together."""
        at, rounds = self.now()
        blocks: list[Block] = []
        for actor in self.actors:
            pose, weights = sample(actor, at / self.fps)
            blocks += pose_blocks(actor, pose, weights)
            name = self.deformers.get(actor.name, "")
            if name in SERVED:
                blocks += self._served(actor, name, pose, weights)
        fields = {"seq": seq, "tick": int(at + 1e-6), "t": at / self.fps, "frame": at, "round": rounds}
        state = self.running() | {"change": self.change, "deformers": self.deformers}
        return encode("frame", fields | state, blocks)

    def _served(self, actor: Actor, name: str, pose: NDArray, weights: NDArray) -> list[Block]:
        for i, w in self.displaced[actor.name].items():
            weights = weights.copy()
            weights[i] = w
        if (actor.name, name) not in self.vertices:
            self.vertices[actor.name, name] = Vertices(actor, name)
        return self.vertices[actor.name, name].blocks(turned(actor, pose, self.turns[actor.name]), weights)


@cache
def static(name: str) -> tuple[bytes, str] | None:
    """Bytes and content type of a file of the page, by its name in the table; None for anything else."""
    if name not in FILES:
        return None
    path = FOLDER / FILES[name]
    return path.read_bytes(), KINDS[path.suffix]


def _policy(port: int) -> str:
    page = static("")
    assert page is not None
    inline = re.findall(rb"<script type=\"importmap\">(.*?)</script>", page[0], re.S)
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(s).digest()).decode()}'" for s in inline)
    sockets = f"ws://127.0.0.1:{port} ws://localhost:{port}"
    return (
        f"default-src 'self'; script-src 'self' {hashes}; connect-src 'self' {sockets}; img-src 'self' data: blob:; "
        "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def application(showing: Showing, token: str, port: int) -> ASGIApp:
    """The ASGI application that shows `showing` to pages that know the token."""
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.routing import Route, WebSocketRoute

    hosts = {f"{host}:{port}" for host in ("127.0.0.1", "localhost", "[::1]")}
    headers = {
        "Content-Security-Policy": _policy(port),
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cache-Control": "no-store",
    }
    pages: set[WebSocket] = set()

    async def file(request: Request) -> Response:
        found = static(request.path_params["name"])
        if found is None:
            return Response("not found\n", 404, headers)
        return Response(found[0], 200, headers, media_type=found[1])

    async def socket_of(ws: WebSocket) -> None:
        origin = ws.headers.get("origin")
        if origin != f"http://{ws.headers.get('host')}":
            await ws.close(1008)
            return
        if len(pages) >= MAX_PAGES:
            await ws.accept()
            await ws.close(1013, "too many pages")
            return
        pages.add(ws)
        try:
            await ws.accept()
            await _converse(ws, showing, token)
        finally:
            pages.discard(ws)

    app = Starlette(routes=[WebSocketRoute("/stream", socket_of), Route("/{name:path}", file, methods=["GET"])])

    async def guarded(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            host = dict(scope["headers"]).get(b"host", b"").decode("latin-1")
            if host not in hosts:  # a foreign name that resolves to this machine: DNS rebinding
                if scope["type"] == "websocket":
                    await receive()
                    await send({"type": "websocket.close", "code": 1008})
                else:
                    await Response("unknown host\n", 403, headers)(scope, receive, send)
                return
        await app(scope, receive, send)

    return guarded


async def _converse(ws: WebSocket, showing: Showing, token: str) -> None:
    from starlette.websockets import WebSocketDisconnect

    try:
        first = parse_request(await asyncio.wait_for(_text(ws), PATIENCE))
    except (VitruvianError, TimeoutError):
        await ws.close(1008, "expected hello")
        return
    except WebSocketDisconnect:
        return
    if first["type"] != "hello" or not hmac.compare_digest(first["token"].encode(), token.encode()):
        await ws.close(1008, "wrong token")
        return
    if first["version"] != VERSION:
        await ws.close(1008, f"expected version {VERSION}; reload the page")
        return
    page = _Page(ws, showing)
    tasks = {asyncio.create_task(page.send()), asyncio.create_task(page.listen())}
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            error = task.exception()
            if error is not None and not isinstance(error, (WebSocketDisconnect, RuntimeError, OSError)):
                logging.getLogger(__name__).error("the page was closed", exc_info=error)
                with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):
                    await ws.close(1011, str(error)[:100])
    finally:
        showing.wake.discard(page.event)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _text(ws: WebSocket) -> str:
    from starlette.websockets import WebSocketDisconnect

    message = await ws.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code") or 1000)
    text = message.get("text")
    if text is None:
        raise VitruvianError("request: expected text, found bytes")
    return text


class _Page:
    """One connected page: what was sent to it and what it acknowledged."""

    def __init__(self, ws: WebSocket, showing: Showing):
        self.ws, self.showing = ws, showing
        self.event = asyncio.Event()
        self.sent = self.acked = 0
        self.strikes, self.times = 0, deque[float](maxlen=RATE)
        showing.wake.add(self.event)

    async def send(self) -> None:
        """Meshes, then the newest frame whenever fewer than `IN_FLIGHT` are unacknowledged: nothing ever queues up."""
        showing = self.showing
        showing.begin()
        await self.ws.send_bytes(showing.hello())
        for mesh in showing.meshes:
            await self.ws.send_bytes(mesh)
        told, due = -1, 0.0
        while True:
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            self.event.clear()
            if self.sent - self.acked < IN_FLIGHT and (showing.playing or told != showing.change):
                self.sent += 1
                message = showing.frame(self.sent)
                told, due = showing.change, time.monotonic() + INTERVAL
                await self.ws.send_bytes(message)
            elif self.sent - self.acked >= IN_FLIGHT or not showing.playing:
                await self.event.wait()

    async def listen(self) -> None:
        while True:
            try:
                request = parse_request(await _text(self.ws))
                self._limit()
                if request["type"] == "ack":
                    self.acked = min(max(self.acked, request["seq"]), self.sent)
                    self.event.set()
                elif request["type"] == "hello":
                    raise VitruvianError("request hello: expected once")
                else:
                    self.showing.apply(request)
            except VitruvianError as error:
                self.strikes += 1
                await self.ws.send_bytes(encode("error", {"message": str(error)[:300], "strikes": self.strikes}))
                if self.strikes >= STRIKES:
                    await self.ws.close(1008, "too many bad requests")
                    return

    def _limit(self) -> None:
        now = time.monotonic()
        if len(self.times) == RATE and now - self.times[0] < 1:
            raise VitruvianError(f"request: expected at most {RATE} in a second")
        self.times.append(now)


class Server:
    """A showing on a free port of the loopback interface. `url` opens it; `run` serves until `stop`."""

    def __init__(self, showing: Showing, port: int = 0, *, token: str = ""):
        import uvicorn

        self.showing, self.token = showing, token or secrets.token_hex(16)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self.socket.bind(("127.0.0.1", port))
        except OSError as error:
            raise VitruvianError(
                f"show: can't listen on 127.0.0.1:{port}: {error.strerror}; give another port"
            ) from None
        self.port = self.socket.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/#token={self.token}"
        config = uvicorn.Config(
            application(showing, self.token, self.port),
            log_level="critical",
            access_log=False,
            lifespan="off",
            server_header=False,
            ws_max_size=MAX_REQUEST,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)

    def run(self) -> None:
        """Serve in this thread until `stop` or, in the main thread, an interrupt."""
        asyncio.run(self._server.serve(sockets=[self.socket]))

    @property
    def started(self) -> bool:
        return self._server.started

    def stop(self) -> None:
        self._server.should_exit = True
