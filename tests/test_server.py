"""The local server: what it serves, what it refuses, how it streams."""

from __future__ import annotations

import http.client
import json
import random
import socket
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from capsules import capsule_clip
from vitruvian.errors import VitruvianError
from vitruvian.show.actors import actors_of
from vitruvian.show.live import show
from vitruvian.show.recording import messages
from vitruvian.show.server import FILES, FOLDER, IN_FLIGHT, Server, Showing
from vitruvian.show.wire import decode


@pytest.fixture(scope="module")
def window():
    with show(capsule_clip(vertices=800), open_browser=False, block=False) as window:
        yield window


def parts(window):
    address = urlsplit(window.url)
    return address.port, address.fragment.removeprefix("token=")


def get(port, path, method="GET", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    connection.putrequest(method, path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    return response.status, dict(response.getheaders()), response.read()


def dial(window, origin=None, **options):
    port, _ = parts(window)
    return connect(
        f"ws://127.0.0.1:{port}/stream",
        origin=origin or f"http://127.0.0.1:{port}",
        max_size=None,
        open_timeout=5,
        **options,
    )


def hello(window, socket_, token=None):
    socket_.send(json.dumps({"type": "hello", "token": token or parts(window)[1], "version": 1}))


def receive(socket_, kind, timeout=5.0):
    """The next message of that type; frames on the way are acknowledged."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        header, arrays = decode(socket_.recv(timeout=timeout))
        if header["type"] == "frame":
            socket_.send(json.dumps({"type": "ack", "seq": header["seq"]}))
        if header["type"] == kind:
            return header, arrays
    raise AssertionError(f"no {kind}")


def test_the_files_of_the_page_are_served_with_a_policy(window):
    port, token = parts(window)
    assert len(token) == 32
    for name in FILES:
        status, headers, body = get(port, "/" + name)
        assert status == 200 and body == (FOLDER / FILES[name]).read_bytes()
        assert "default-src 'self'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff" and headers["cache-control"] == "no-store"
        assert "access-control-allow-origin" not in headers and token.encode() not in body
    on_disk = {str(p.relative_to(FOLDER)) for p in FOLDER.rglob("*.*") if p.suffix in (".js", ".css", ".html")}
    assert on_disk == set(FILES.values())


@pytest.mark.parametrize(
    "path",
    ["/../server.py", "/%2e%2e/server.py", "/..%2fserver.py", "//etc/passwd", "/etc/passwd", "/main.js%00", "/vendor/",
     "/vendor/../main.js", "/index.html", "/main.js/", "/%c0%ae%c0%ae/server.py", "/" + "a" * 9000,
     "/vendor/LICENSE-three.txt"],
)  # fmt: skip
def test_other_paths_are_not_found(window, path):
    status, _, body = get(parts(window)[0], path)
    assert status in (400, 404) and b"import" not in body and b"root:" not in body


def test_other_methods_and_foreign_hosts_are_refused(window):
    port, _ = parts(window)
    for method in ("POST", "PUT", "DELETE", "OPTIONS"):
        assert get(port, "/", method)[0] == 405
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1.evil.example:{port}", ""):
        assert get(port, "/", Host=host)[0] in (400, 403)
    assert get(port, "/", Host=f"localhost:{port}")[0] == 200


def test_foreign_origins_and_hosts_get_no_socket(window):
    port, _ = parts(window)
    for origin in (
        "http://evil.example",
        "null",
        f"http://localhost:{port}",
        f"https://127.0.0.1:{port}",
        "http://127.0.0.1",
    ):
        with pytest.raises(InvalidStatus), dial(window, origin):
            pass
    with pytest.raises(InvalidStatus), connect(f"ws://127.0.0.1:{port}/stream"):
        pass
    with (
        pytest.raises((InvalidStatus, ConnectionClosed)),
        dial(window, additional_headers={"Host": "evil.example"}) as ws,
    ):
        hello(window, ws)
        ws.recv(timeout=3)


@pytest.mark.parametrize(
    "first",
    ['{"type": "hello", "token": "", "version": 1}',
     '{"type": "hello", "token": "é", "version": 1}', '{"type": "play"}', "",
     "{",
     '{"type": "hello", "version": 1}', b"\x00\x01", '{"type": "hello", "token": "%s", "version": 1}' % ("0" * 32)],
)  # fmt: skip
def test_nothing_is_sent_before_the_right_token(window, first):
    with dial(window) as ws:
        ws.send(first)
        with pytest.raises(ConnectionClosed) as caught:
            ws.recv(timeout=5)
        assert caught.value.rcvd.code == 1008


def test_a_silent_page_is_dropped_and_too_many_pages_are_refused(window, monkeypatch):
    import vitruvian.show.server as server

    monkeypatch.setattr(server, "PATIENCE", 0.3)
    with dial(window) as ws, pytest.raises(ConnectionClosed):
        ws.recv(timeout=5)
    monkeypatch.setattr(server, "PATIENCE", 20)
    time.sleep(0.2)
    open_ = [dial(window, legacy=True) for _ in range(server.MAX_PAGES)]
    try:
        with dial(window) as ws, pytest.raises(ConnectionClosed) as caught:
            ws.recv(timeout=5)
        assert caught.value.rcvd.code == 1013
    finally:
        for ws in open_:
            ws.close()
    time.sleep(0.2)
    with dial(window) as ws:
        hello(window, ws)
        assert receive(ws, "hello")[0]["actors"] == ["capsules"]


def test_bad_requests_are_answered_and_the_third_closes(window):
    with dial(window) as ws:
        hello(window, ws)
        receive(ws, "mesh")
        for n, bad in enumerate(
            ['{"type": "exec"}', '{"type": "deformer", "actor": "capsules", "name": "x"}', "[]"], 1
        ):
            ws.send(bad)
            header, _ = receive(ws, "error")
            assert header["strikes"] == n and "\n" not in header["message"]
        with pytest.raises(ConnectionClosed):
            receive(ws, "nothing")


def test_oversized_and_fuzzed_frames_do_not_hurt_the_server(window):
    rng = random.Random(5)
    port, _ = parts(window)
    with dial(window) as ws, pytest.raises(ConnectionClosed):
        hello(window, ws)
        ws.send("x" * 200_000)
        receive(ws, "nothing")
    for _ in range(20):
        with dial(window) as ws:
            hello(window, ws)
            try:
                for _ in range(4):
                    ws.send(
                        rng.randbytes(rng.randrange(300)) if rng.random() < 0.5 else rng.randbytes(50).decode("latin-1")
                    )
            except ConnectionClosed:
                pass
    for _ in range(20):
        with socket.create_connection(("127.0.0.1", port), timeout=2) as raw:
            raw.sendall(rng.randbytes(400))
    with dial(window) as ws:
        hello(window, ws)
        assert receive(ws, "frame")[0]["frame"] >= 0


def test_transport_does_what_it_says(window):
    with dial(window) as ws:
        hello(window, ws)
        receive(ws, "mesh")

        def ask(**request):
            ws.send(json.dumps(request))

        def until(condition):
            for _ in range(200):
                header, arrays = receive(ws, "frame")
                if condition(header):
                    return header, arrays
            raise AssertionError("the state never came")

        ask(type="pause")
        until(lambda h: not h["playing"])
        ask(type="seek", frame=9)
        header, arrays = until(lambda h: h["frame"] == 9)
        (actor,) = actors_of([capsule_clip(vertices=800)])
        np.testing.assert_array_equal(arrays["capsules", "pose"], actor.poses[9])
        ask(type="step", frames=-10)
        until(lambda h: h["frame"] == 35)
        ask(type="deformer", actor="capsules", name="hybrid")
        header, arrays = until(lambda h: h["deformers"]["capsules"] == "hybrid")
        assert arrays["capsules", "vertices"].dtype == np.int16 and arrays["capsules", "normals"].dtype == np.int8
        before = arrays["capsules", "vertices"].copy()
        seen = header["change"]
        ask(type="set_rotation", actor="capsules", joint="l_elbow", rotation=[0, 0, 1, 0])
        assert not np.array_equal(until(lambda h: h["change"] == seen + 1)[1]["capsules", "vertices"], before)
        ask(type="clear_pose", actor="capsules")
        np.testing.assert_array_equal(until(lambda h: h["change"] == seen + 2)[1]["capsules", "vertices"], before)
        seen += 2
        ask(type="set_displacer", actor="capsules", name="grow_action", weight=3)
        assert not np.array_equal(until(lambda h: h["change"] == seen + 1)[1]["capsules", "vertices"], before)
        ask(type="clear_displacer", actor="capsules", name="grow_action")
        np.testing.assert_array_equal(until(lambda h: h["change"] == seen + 2)[1]["capsules", "vertices"], before)
        ask(type="deformer", actor="capsules", name="log")
        ask(type="speed", value=2)
        ask(type="play")
        a, _ = until(lambda h: h["playing"] and h["speed"] == 2)
        start, began = a["round"] * 36 + a["frame"], time.monotonic()
        until(lambda h: h["round"] * 36 + h["frame"] > start + 40)  # over the end of the loop, 60 frames a second
        assert 0.4 < time.monotonic() - began < 4
        ask(type="speed", value=1)


@pytest.mark.parametrize("name", ["l_elbow", "", "grow_action ", "__proto__", "x" * 200])
def test_displacers_that_do_not_exist_are_not_cleared(name):
    showing = Showing(actors_of([capsule_clip(vertices=300)]))
    with pytest.raises(VitruvianError, match="has no"):
        showing.apply({"type": "clear_displacer", "actor": "capsules", "name": name})
    assert showing.change == 0


def test_a_slow_page_never_has_more_than_three_frames_in_flight(window):
    with dial(window) as ws:
        hello(window, ws)
        seen = []
        ws.send(json.dumps({"type": "play"}))
        end = time.monotonic() + 0.8
        while time.monotonic() < end:
            try:
                header, _ = decode(ws.recv(timeout=0.2))
            except TimeoutError:
                break
            if header["type"] == "frame":
                seen.append(header["seq"])
        assert len(seen) == IN_FLIGHT
        time.sleep(0.3)
        stamp = time.monotonic()
        ws.send(json.dumps({"type": "ack", "seq": seen[-1]}))
        late, _ = decode(ws.recv(timeout=2))
        again, _ = decode(ws.recv(timeout=2))
        assert late["seq"] == seen[-1] + 1  # the newest frame, not one of a queue
        assert again["seq"] == late["seq"] + 1 and time.monotonic() - stamp < 1


def test_a_recording_holds_the_frames_that_a_server_sends():
    actors = actors_of([capsule_clip(vertices=800)])
    showing = Showing(actors)
    stored = messages(showing)
    showing.playing = False
    for n in (0, 17, 35):
        showing.apply({"type": "seek", "frame": n})
        live, recorded = decode(showing.frame(1)), decode(stored[2 + n])
        assert recorded[0]["tick"] == live[0]["tick"] == n
        for key, array in recorded[1].items():
            assert array.tobytes() == live[1][key].tobytes()
    assert stored[1] == showing.meshes[0] and len(stored) == 2 + 36


def test_a_port_that_is_taken_is_one_clear_line():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(VitruvianError, match="can't listen"):
            Server(Showing(actors_of([capsule_clip(vertices=300)])), other.getsockname()[1])
