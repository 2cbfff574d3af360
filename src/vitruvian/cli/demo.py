"""The demo: a person walks."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, emit, progress, say


@app.command(epilog="Example: vitruvian demo --out demo")
def demo(
    out: Path = typer.Option(Path("out/demo"), "--out", help="Folder for the files."),
    no_open: bool = typer.Option(False, "--no-open", help="Write the files without opening the page."),
    as_json: bool = Json,
) -> None:
    """A built-in person walks: writes GLB, X3D, a picture, a film and a self-contained page, and opens the page."""
    from vitruvian.body.kinematics import joint_matrices
    from vitruvian.body.pack import pack
    from vitruvian.deform.deformer import deformer
    from vitruvian.formats.registry import save
    from vitruvian.modeling.person import person
    from vitruvian.motion.gait import walk
    from vitruvian.show.picture import picture
    from vitruvian.show.recording import record
    from vitruvian.stage.clip import Clip

    seconds: dict[str, float] = {}

    @contextmanager
    def step(name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        seconds[name] = time.perf_counter() - start
        say(f"{name:<10} {seconds[name]:6.2f} s")

    out.mkdir(parents=True, exist_ok=True)
    with step("person"):
        humanoid = person(gender=0, age=28, height=1.70)
        body = pack(humanoid)
    with step("motion"):
        motion = walk(body.skeleton, cycles=2)  # the film shows one of them
        clip = Clip(humanoid, body, motion)
    with step("deform"):
        matrices = joint_matrices(body.skeleton, motion)
        move = deformer(clip.deformer, body)
        start = time.perf_counter()
        for frame in matrices:
            move(frame[None])
        stage_fps = len(matrices) / (time.perf_counter() - start)
    files = [out / f"demo.{kind}" for kind in ("glb", "x3d", "html", "png")]
    with step("glb"):
        save(clip, files[0])
    with step("x3d"):
        save(clip, files[1])
    with step("page"):
        record(clip, files[2])
    with step("picture"):
        picture(clip, files[3])
    if find_spec("av"):
        from vitruvian.show.film import film

        files.append(out / "demo.mp4")
        with step("film"), progress("film") as update:
            film(clip, files[-1], size=(480, 640), seconds=motion.seconds / 2, progress=update)
    document = {"files": [str(f) for f in files], "seconds": seconds, "stage_fps": stage_fps}
    text = "\n".join(f"wrote {f}" for f in files)
    if not no_open:
        import webbrowser

        if not webbrowser.open(files[2].resolve().as_uri()):
            text += f"\nopen {files[2]} in a browser"
    emit(document, text, as_json)
