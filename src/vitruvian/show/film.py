"""Films of a moving figure: MP4, GIF, WebP or a folder of PNGs. The camera follows where the figure goes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from vitruvian.errors import MissingExtra, VitruvianError
from vitruvian.formats.atomic import atomic
from vitruvian.show.camera import Camera, _tuple
from vitruvian.show.darkroom import Job, develop
from vitruvian.show.figure import Figure, Thing
from vitruvian.show.picture import aim, floor_of
from vitruvian.show.render import Pixels, whole
from vitruvian.show.shade import Studio
from vitruvian.show.surfaces import Surface


def film(
    thing: Thing,
    path: str | os.PathLike[str],
    *,
    fps: float = 30.0,
    size: tuple[int, int] = (720, 960),
    view: str | Camera = "three-quarter",
    seconds: float | None = None,
    samples: int = 4,
    turn: float = 0.0,
    studio: Studio | None = None,
    processes: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Film a Clip (or Humanoid, Body, Mesh, Motion); returns the number of frames.

    path: `.mp4` (H.264, yuv420p; needs the extra `film`), `.gif`, `.webp`, or a name with `%04d.png` in it for a
    sequence of pictures. seconds: length, by default that of the motion (3 s without one). turn: degrees per second
    that the camera goes round. processes: how many render at once, by default one per processor. progress(done, total)
    is called after each frame. Raises `MissingExtra` without PyAV, `VitruvianError` for other endings, sizes and rates.
    """
    name = os.fspath(path)
    ending = os.path.splitext(name)[1].lower()
    if not (np.isfinite(fps) and 0 < fps <= 240):
        raise VitruvianError(f"fps: expected a number in 0..240, found {fps}")
    write = {".mp4": _mp4, ".gif": _animated, ".webp": _animated, ".png": _sequence}.get(ending)
    if write is None:
        raise VitruvianError(f"{name}: expected a name that ends in .mp4, .gif, .webp or %04d.png, found {ending!r}")
    size = whole(size)
    if write is _mp4:
        _av()
        size = (max(size[0] // 2 * 2, 2), max(size[1] // 2 * 2, 2))  # chroma is stored for blocks of 2 x 2
    figure = Figure(thing)
    length = seconds if seconds is not None else figure.seconds or 3.0
    count = max(round(length * fps), 1)
    if count > 100_000:
        raise VitruvianError(f"seconds: expected a film of at most 100000 frames, found {count}")
    times = [i / fps for i in range(count)]
    jobs = _jobs(figure, times, size, view, turn, {"samples": samples, "studio": studio, "quality": 4})
    frames = develop(jobs, processes if count >= 8 else 1)
    total = _counted(frames, count, progress)
    write(name, total, fps, size)
    return count


def _counted(frames: Iterator[Pixels], total: int, progress: Callable[[int, int], None] | None) -> Iterator[Pixels]:
    for i, pixels in enumerate(frames):
        yield pixels
        if progress:
            progress(i + 1, total)


def _jobs(
    figure: Figure,
    times: list[float],
    size: tuple[int, int],
    view: str | Camera,
    turn: float,
    options: dict[str, object],
) -> Iterator[Job]:
    looped = figure.motion is not None and figure.motion.loop
    path = figure.path([t % figure.seconds if looped and figure.seconds else t for t in times])
    camera, floor = _follow(figure, times, view, size)
    for t, at, surface in zip(times, path, figure.at(times)):
        yield [surface], _round(camera, turn * t).moved(at), size, {**options, "floor": floor}


def _follow(figure: Figure, times: list[float], view: str | Camera, size: tuple[int, int]) -> tuple[Camera, float]:
    """A camera that holds the figure at every time when it is moved along with it, and the height of the floor."""
    some = times[:: max(len(times) // 8, 1)][:9]
    looped = figure.motion is not None and figure.motion.loop
    path = figure.path([t % figure.seconds if looped and figure.seconds else t for t in some])
    all_of = [Surface(s.vertices - at, s.triangles, None, None, s.parts) for s, at in zip(figure.at(some), path)]
    floor = min(floor_of(figure, s) for s in all_of)
    if isinstance(view, Camera):
        return view, floor
    if view in ("front", "side", "back", "three-quarter"):
        n = len(all_of[0].vertices)
        union = Surface(
            np.concatenate([s.vertices for s in all_of]),
            np.concatenate([s.triangles + i * n for i, s in enumerate(all_of)]),
        )
        return _steady(figure, union, view, size), floor
    return aim(figure, all_of[0], view, 0.0, size)[0], floor


def _steady(figure: Figure, union: Surface, view: str, size: tuple[int, int]) -> Camera:
    from vitruvian.show.camera import stand
    from vitruvian.show.picture import _drawn

    return stand(_drawn(union), view, size, heading=figure.heading())


def _round(camera: Camera, degrees: float) -> Camera:
    """The camera carried round its target about Y."""
    if not degrees:
        return camera
    a = np.radians(degrees)
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    eye = np.asarray(camera.target) + turn @ np.subtract(camera.eye, camera.target)
    return Camera(_tuple(eye), camera.target, camera.fov, camera.up)


def _av() -> Any:
    try:
        import av
    except ImportError:
        raise MissingExtra("film", "writing MP4") from None
    return av


def _mp4(name: str, frames: Iterable[Pixels], fps: float, size: tuple[int, int]) -> None:
    av = _av()
    with (
        atomic(name) as temporary,
        av.open(str(temporary), "w", format="mp4", options={"movflags": "faststart"}) as out,
    ):
        stream = out.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = size[0], size[1], "yuv420p"
        stream.options = {"crf": "17", "preset": "medium", "colorprim": "bt709"}
        for pixels in frames:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
            for packet in stream.encode(frame):
                out.mux(packet)
        for packet in stream.encode():
            out.mux(packet)


def _animated(name: str, frames: Iterable[Pixels], fps: float, size: tuple[int, int]) -> None:
    from PIL import Image

    images = (Image.fromarray(p) for p in frames)
    first = next(images)
    kind = "GIF" if name.lower().endswith(".gif") else "WEBP"
    # one palette for all frames, so that the backdrop does not flicker
    if kind == "GIF":
        first = first.quantize(255, dither=Image.Dither.FLOYDSTEINBERG)
        palette = first
        images = (i.quantize(palette=palette, dither=Image.Dither.NONE) for i in images)
    with atomic(name) as temporary:
        first.save(
            temporary,
            kind,
            save_all=True,
            append_images=images,
            duration=max(round(1000 / fps), 20),
            loop=0,
            quality=85,
        )


def _sequence(name: str, frames: Iterable[Pixels], fps: float, size: tuple[int, int]) -> None:
    from PIL import Image

    try:
        distinct = name % 0 != name % 1
    except (TypeError, ValueError):
        distinct = False
    if not distinct:
        raise VitruvianError(f"{name}: expected a place for the frame number, such as walk-%04d.png")
    for i, pixels in enumerate(frames):
        with atomic(name % i) as temporary:
            Image.fromarray(pixels).save(temporary, "PNG")
