"""Films: as many frames as asked for, that play elsewhere; nothing is left behind by a failure."""

from __future__ import annotations

import builtins
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from small_body import figure, wave
from vitruvian.errors import MissingExtra, VitruvianError
from vitruvian.formats.atomic import atomic
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.show.film import film
from vitruvian.stage.clip import Clip


@pytest.fixture
def clip() -> Clip:
    body = figure()
    return Clip(Humanoid("tester"), body, wave(body), "linear")


def test_mp4(clip: Clip, tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="needs the extra: pip install 'vitruvian[film]'")
    calls: list[tuple[int, int]] = []
    count = film(
        clip, tmp_path / "a.mp4", fps=12, size=(65, 81), seconds=0.5, samples=1, progress=lambda *n: calls.append(n)
    )
    assert count == 6 and calls == [(i + 1, 6) for i in range(6)]
    with av.open(str(tmp_path / "a.mp4")) as file:
        stream = file.streams.video[0]
        assert (stream.codec_context.name, stream.format.name) == ("h264", "yuv420p")
        assert (stream.width, stream.height, float(stream.average_rate)) == (64, 80, 12.0)
        frames = [f.to_ndarray(format="rgb24").astype(int) for f in file.decode(stream)]
    assert len(frames) == 6 and np.abs(frames[0] - frames[3]).max() > 40


def test_gif_webp_and_sequence(clip: Clip, tmp_path: Path) -> None:
    for name in ("a.gif", "a.webp"):
        assert film(clip, tmp_path / name, fps=10, size=(40, 50), seconds=0.4, samples=1) == 4
        with Image.open(tmp_path / name) as image:
            assert image.n_frames == 4 and image.size == (40, 50)
    film(clip, tmp_path / "f-%03d.png", fps=10, size=(40, 50), seconds=0.3, samples=1, turn=90)
    assert sorted(p.name for p in tmp_path.glob("f-*")) == ["f-000.png", "f-001.png", "f-002.png"]


def test_length_is_that_of_the_motion(clip: Clip, tmp_path: Path) -> None:
    assert film(clip, tmp_path / "a.gif", fps=8, size=(24, 32), samples=1) == 4  # 12 frames at 24 a second


def test_workers_make_the_same_pictures(clip: Clip, tmp_path: Path) -> None:
    for n in (1, 2):
        film(clip, tmp_path / f"{n}-%02d.png", fps=10, size=(40, 50), seconds=0.8, samples=1, processes=n)
    for i in range(8):
        one, two = (np.asarray(Image.open(tmp_path / f"{n}-{i:02d}.png")) for n in (1, 2))
        assert (one == two).all()


def test_an_error_in_a_worker_is_one_line() -> None:
    from vitruvian.show.camera import Camera
    from vitruvian.show.darkroom import develop

    job = ([], Camera((0, 0, 1), (0, 0, 0)), (8, 8), {})
    with pytest.raises(VitruvianError, match="nothing to see"):
        list(develop([job, job], 2))


def test_camera_follows(tmp_path: Path) -> None:
    """A figure that walks away stays in the middle of the picture."""
    from dataclasses import replace

    from vitruvian.show.figure import Figure
    from vitruvian.show.film import _follow

    body = figure()
    motion = wave(body, 24, loop=False)
    away = replace(motion, translation=motion.translation + np.linspace(0, 3, 24)[:, None] * [0, 0, 1])
    who = Figure(Clip(Humanoid("t"), body, away, "linear"))
    times = [i / 24 for i in range(24)]
    camera, _ = _follow(who, times, "side", (100, 100))
    for at, surface in zip(who.path(times), who.at(times)):
        pixels, _ = camera.moved(at).project(surface.vertices[np.unique(surface.triangles)], (100, 100))
        assert pixels.min() > -2 and pixels.max() < 102


def test_refused(clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, options, what in (
        ("a.avi", {}, "ends in"),
        ("a.png", {}, "frame number"),
        ("a.gif", {"fps": float("nan")}, "fps"),
        ("a.gif", {"seconds": 1e9}, "frames"),
        ("a.gif", {"view": "inside"}, "view inside"),
    ):
        with pytest.raises(VitruvianError, match=what):
            film(clip, tmp_path / name, size=(16, 16), samples=1, **options)
    real = builtins.__import__

    def missing(name: str, *rest: object, **more: object):  # type: ignore[no-untyped-def]
        if name == "av":
            raise ImportError(name)
        return real(name, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(MissingExtra, match=r"vitruvian\[film\]"):
        film(clip, tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


def test_a_failure_half_way_leaves_the_old_file(clip: Clip, tmp_path: Path) -> None:
    path = tmp_path / "a.gif"
    path.write_bytes(b"old")

    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        film(clip, path, fps=10, size=(16, 16), seconds=0.5, samples=1, progress=stop)
    assert path.read_bytes() == b"old" and [p.name for p in tmp_path.iterdir()] == ["a.gif"]


def test_atomic(tmp_path: Path) -> None:
    with atomic(tmp_path / "x.txt") as path:
        path.write_text("new")
        assert path.suffix == ".txt" and not (tmp_path / "x.txt").exists()
    assert (tmp_path / "x.txt").read_text() == "new"
    with pytest.raises(VitruvianError, match="does not exist"), atomic(tmp_path / "no" / "x.txt"):
        pass
    with pytest.raises(VitruvianError, match="is a folder"), atomic(tmp_path):
        pass
