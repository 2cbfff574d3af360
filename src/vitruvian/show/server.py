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
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from vitruvian.errors import VitruvianError
from vitruvian.show.showing import MAX_FINDINGS as MAX_FINDINGS
from vitruvian.show.showing import Showing
from vitruvian.show.wire import MAX_REQUEST, VERSION, encode, parse_request

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Receive, Scope, Send
    from starlette.websockets import WebSocket

    from vitruvian.body.types import Body

FOLDER = Path(__file__).parent / "page"
MODULES = (
    "main.js",
    "wire.js",
    "source.js",
    "deform.js",
    "mesh.js",
    "contours.js",
    "hands.js",
    "tuning.js",
    "volume.js",
    "forks.js",
    "operators.js",
    "skin.js",
    "sections.js",
    "gauge.js",
    "compare.js",
    "stripes.js",
    "detail.js",
    "fineness.js",
    "surface.js",
    "girths.js",
    "searching.js",
    "picking.js",
    "painting.js",
    "pose.js",
    "handles.js",
    "marks.js",
    "pictures.js",
    "figure.js",
    "heat.js",
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
PATIENCE = 5.0  # seconds for the first message
PAUSED = 0.1  # seconds between looks at a stage that stands still


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
        levels: dict[str, Body | None] = {}
        pictures: set[str] = set()  # that this page has
        told, due, heard = (-1, -1), 0.0, showing.search.version
        while True:
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            self.event.clear()
            if heard != showing.search.version:
                heard = showing.search.version
                await self.ws.send_bytes(encode("search", showing.search.told))
            if self.sent - self.acked < IN_FLIGHT and (showing.playing or told != showing.told):
                self.sent += 1
                message = showing.frame(self.sent)
                told, due = showing.told, time.monotonic() + INTERVAL
                if levels != showing.levels:  # at first, and when there are other points: all anew, before the frame
                    levels = showing.levels
                    meshes = showing.meshes
                    fresh = [m for name, m in showing.pictures.items() if name not in pictures]
                    pictures |= showing.pictures.keys()
                    for part in (showing.hello(), *fresh, *meshes):
                        await self.ws.send_bytes(part)
                await self.ws.send_bytes(message)
            elif self.sent - self.acked >= IN_FLIGHT or not showing.playing:
                with contextlib.suppress(TimeoutError):  # a script may have sent something to the stage
                    await asyncio.wait_for(self.event.wait(), PAUSED)

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
                    answer = self.showing.apply(request)
                    if answer is not None:
                        await self.ws.send_bytes(answer)
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
