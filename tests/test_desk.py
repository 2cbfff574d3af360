"""The server of the pattern editor: what it takes, what it refuses, and the command that opens it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import vitruvian as vt
from test_dressing import skirt
from vitruvian.cli.desk import desk_of
from vitruvian.cloth.pattern import Pattern, length
from vitruvian.errors import VitruvianError
from vitruvian.formats.pattern_file import document, pattern_from, write_any
from vitruvian.show.editing import EMPTY, Editing
from vitruvian.show.live import Window, serve
from vitruvian.show.server import ELSEWHERE, Server
from vitruvian.show.wire import decode

MEASURES = {"height": 1.67, "chest": 0.9, "waist": 0.72, "hips": 0.96}


@pytest.fixture(scope="module")
def body():
    return vt.pack(vt.person(outfit=None, hair="none"))


@pytest.fixture
def served(body):
    desk = Editing(skirt(), body, measures=MEASURES)
    server = Server(desk)
    with Window(server, serve(server)) as window:
        yield desk, window


@contextmanager
def dial(window, token=None, version=1):
    address = urlsplit(window.url)
    origin = f"http://127.0.0.1:{address.port}"
    said = token if token is not None else address.fragment.removeprefix("token=")
    with connect(f"ws://127.0.0.1:{address.port}/stream", origin=origin, max_size=None, open_timeout=5) as socket:
        socket.send(json.dumps({"type": "hello", "token": said, "version": version}))
        yield socket


def ask(socket, kind, **fields):
    socket.send(json.dumps({"type": kind, **fields}))


def receive(socket, kind, timeout=20.0):
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        header, arrays = decode(socket.recv(timeout=timeout))
        if header["type"] == kind:
            return header, arrays
    raise AssertionError(f"no {kind}")


def put(socket, text, seq=1):
    for at in range(0, max(1, len(text)), 20_000):
        ask(socket, "pattern", seq=seq, text=text[at : at + 20_000], last=at + 20_000 >= len(text))


def test_a_page_hears_the_document_and_the_body_and_the_doctor(served, body):
    desk, window = served
    with dial(window) as socket:
        header, _ = receive(socket, "hello")
        assert pattern_from(header["document"], "x").name == "skirt"
        assert header["saved"] and header["measures"] == MEASURES and "cotton" in header["fabrics"]
        _, arrays = receive(socket, "body")
        assert arrays["", "vertices"].shape == desk.dummy.vertices.shape
        assert arrays["", "triangles"].max() < len(arrays["", "vertices"])
        assert receive(socket, "findings")[0]["findings"] == []


def test_without_the_token_there_is_nothing(served):
    for options in ({"token": "0" * 32}, {"token": ""}, {"version": 7}):
        with dial(served[1], **options) as socket, pytest.raises(ConnectionClosed):
            socket.recv(timeout=5)


def test_a_document_comes_in_pieces_and_is_examined(served):
    desk, window = served
    said = document(skirt())
    said["extra"]["note"] = "x" * 50_000
    said["panels"][0]["edges"][0]["ends"] = [0, 2]  # its outline is open
    with dial(window) as socket:
        receive(socket, "findings")
        put(socket, json.dumps(said), 5)
        header, _ = receive(socket, "findings")
        assert header["seq"] == 5 and any(f["rule"] == "P01" and f["panel"] == "front" for f in header["findings"])
        assert desk.pattern().extra["note"] == "x" * 50_000


@pytest.mark.parametrize(
    "broken",
    [
        {"panels": [{"name": "front"}]},
        {"panels": "x"},
        {"panels": [{"name": "a", "vertices": [[0, 0], [1e400, 0]], "edges": []}]},
        {"panels": [{"name": "a", "vertices": [[0, 0]], "edges": [{"ends": [0, 9]}]}]},
        {"vitruvian_pattern": 99, "panels": [{}]},
        {"panels": [[]], "seams": 3},
    ],
    ids=range(6),
)
def test_a_document_that_is_no_pattern_is_said_to_be_none(served, broken):
    _, window = served
    with dial(window) as socket:
        receive(socket, "findings")
        put(socket, json.dumps({"vitruvian_pattern": 1, "name": "p", **broken}))
        assert receive(socket, "findings")[0]["problem"]
        ask(socket, "drape", fabric="cotton", size=0.03)
        assert receive(socket, "refused")[0]["of"] == "drape"
        put(socket, json.dumps(document(skirt())), 2)  # and the page lives
        assert receive(socket, "findings")[0] | {"blocks": []} == {
            "type": "findings", "seq": 2, "findings": [], "problem": "", "blocks": [],
        }  # fmt: skip


def test_bad_requests_are_refused_and_three_end_it(served):
    _, window = served
    bad = [
        "[]", "{}", json.dumps({"type": "save", "path": "/etc/passwd"}), json.dumps({"type": "open"}),
        json.dumps({"type": "drape", "fabric": "cotton", "size": 1e-9}), json.dumps({"type": "pattern", "seq": 1}),
    ]  # fmt: skip
    for one in bad:
        with dial(window) as socket:
            receive(socket, "hello")
            for _ in range(3):
                socket.send(one)
            with pytest.raises(ConnectionClosed):
                while True:
                    socket.recv(timeout=5)
    with dial(window) as socket:
        receive(socket, "findings")
        for text in ("not JSON", "[1]", "7", "[" * 5000):
            put(socket, text)
            assert "expected a document" in receive(socket, "refused")[0]["message"]
    with dial(window) as socket:
        assert receive(socket, "hello")[0]["document"]["name"] == "skirt"  # what was there is there


def test_what_cannot_be_done_is_said(served):
    _, window = served
    with dial(window) as socket:
        receive(socket, "findings")
        ask(socket, "save")
        assert "--save" in receive(socket, "refused")[0]["message"]
        ask(socket, "export", format="exe")
        assert receive(socket, "refused")[0]["of"] == "export"
        ask(socket, "drape", fabric="cardboard", size=0.03)
        while (said := receive(socket, "drape")[0])["state"] == "falling":
            pass
        assert said["state"] == "failed" and "cardboard" in said["message"]
        ask(socket, "place", panel="nobody", words="torso front")
        assert receive(socket, "refused")[0]["of"] == "place"


def test_the_newest_page_has_the_pattern(served):
    _, window = served
    with dial(window) as one:
        receive(one, "findings")
        with dial(window) as two:
            receive(two, "findings")
            with pytest.raises(ConnectionClosed) as closed:
                while True:
                    one.recv(timeout=5)
            assert closed.value.rcvd.code == ELSEWHERE
            ask(two, "propose")
            assert receive(two, "proposals")[0]["proposals"] == []  # all edges but hems and waists are sewn


def test_it_drapes_and_is_stopped(served):
    _, window = served
    with dial(window) as socket:
        receive(socket, "findings")
        ask(socket, "drape", fabric="cotton", size=0.04)
        assert receive(socket, "drape")[0]["state"] == "falling"
        header, arrays = receive(socket, "fall")
        assert header["what"] in ("sewing", "draping") and len(arrays["", "panel"]) == len(arrays["", "triangles"])
        ask(socket, "stop")
        assert receive(socket, "drape")[0]["state"] == "stopped"


def test_unsaved_work_is_there_again_and_gone_once_saved(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "skirt.pattern.json"
    write_any(skirt(), path)
    before = path.read_bytes()
    desk = desk_of(path, "person", None)
    assert desk.where == path.name and not desk.recovered
    changed = document(skirt())
    changed["name"] = "longer"
    desk.apply({"type": "pattern", "seq": 1, "text": json.dumps(changed), "last": True})
    assert path.read_bytes() == before  # nothing is written until it is saved
    again = desk_of(path, "person", None)  # the first was killed
    assert again.recovered and again.pattern().name == "longer"
    again.apply({"type": "save"})
    assert vt.load(path).name == "longer"
    assert not list((tmp_path / "state").rglob("*.json"))
    assert not desk_of(path, "person", None).recovered


def test_dimensions_are_those_of_the_body_that_it_is_opened_for(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "skirt.pattern.json"
    lines = [{"panel": "front", "edge": 0, "length": "hips/2 + 3", "fix": "middle", "stretch": False}]
    plain = skirt()
    write_any(Pattern("skirt", plain.panels, plain.seams, extra={"drawing": {"dimensions": lines}}), path)
    desk = desk_of(path, "person", None)
    assert length(desk.pattern().panel("front"), 0) == pytest.approx(desk.measures["hips"] / 2 + 0.03)
    assert length(desk.pattern().panel("back"), 0) == pytest.approx(length(plain.panel("back"), 0))


def test_names_of_files_are_checked_before_anything_opens(tmp_path):
    with pytest.raises(VitruvianError, match=r"--save.*pattern\.json"):
        desk_of(Path("new"), "person", tmp_path / "x.exe")


def test_the_command_prints_an_address_and_starts_empty(tmp_path):
    arguments = [sys.executable, "-m", "vitruvian", "pattern", "edit", "--no-open", "--json"]
    running = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    try:
        assert running.stdout is not None
        text = ""
        while "}" not in text:
            line = running.stdout.readline()
            assert line, "it ended"
            text += line
        window = type("window", (), {"url": json.loads(text)["address"]})
        with dial(window) as socket:
            header, _ = receive(socket, "hello")
            assert header["document"]["panels"] == [] and set(header["formats"]) >= {"pattern.json", "svg", "dxf"}
            assert np.isclose(header["measures"]["height"], 1.66, atol=0.1)
    finally:
        running.terminate()
        running.wait(10)
    assert not list(tmp_path.iterdir()) and EMPTY["panels"] == []
