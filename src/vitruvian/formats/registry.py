"""`load`, `save` and `check`: by extension, one table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vitruvian.errors import FileError, VitruvianError

if TYPE_CHECKING:
    from vitruvian.hanim.doctor import Finding
    from vitruvian.hanim.graph import Scene
    from vitruvian.hanim.humanoid import Humanoid

# extension -> module and function; scenes hold humanoids, the others answer their noun at once
SCENES = {
    ".x3d": ("x3d", "read_x3d"),
    ".x3dv": ("vrml", "read_vrml"),
    ".wrl": ("vrml", "read_vrml"),
    ".wrz": ("vrml", "read_vrml"),
}
READERS = {
    ".bvh": ("bvh", "read_bvh"),
    ".obj": ("obj", "read_obj"),
    ".ply": ("obj", "read_mesh"),
    ".stl": ("obj", "read_mesh"),
}
WRITERS = (".x3d", ".x3dv", ".wrl", ".glb", ".bvh", ".obj")


def _function(where: tuple[str, str]) -> Callable[..., Any]:
    return getattr(import_module(f"vitruvian.formats.{where[0]}"), where[1])


def extension(path: Path) -> str:
    suffixes = [s.lower() for s in path.suffixes]
    return suffixes[-2] if suffixes[-1:] == [".gz"] and len(suffixes) > 1 else (suffixes or [""])[-1]


def _existing(path: str | Path) -> Path:
    path = Path(path)
    if not path.exists():
        raise VitruvianError(f"{path}: no such file")
    if not path.is_file():
        raise VitruvianError(f"{path}: expected a file, found a folder or a device")
    return path


def scene(path: str | Path) -> Scene:
    """The scene graph of an X3D or VRML file. Raises `FileError` where it can't be read."""
    path = _existing(path)
    where = SCENES.get(extension(path))
    if where is None:
        raise VitruvianError(f"{path}: expected a scene ({', '.join(sorted(SCENES))})")
    return _function(where)(path)


def humanoids(path: str | Path, *, repair: bool = False) -> list[Humanoid]:
    """All humanoids of a scene file, in source order; [] when it holds none."""
    from vitruvian.hanim.view import humanoids as view

    return view(scene(path), path, repair=repair)


def load(path: str | Path, *, name: str | None = None, repair: bool = False, **options: Any) -> Any:
    """What a file holds, by its extension: `Humanoid` (.x3d .x3dv .wrl), `Motion` (.bvh) or `Mesh` (.obj).

    `name` picks one of several humanoids. `repair` drops what can't be meant (non-finite numbers, indices outside their
    array) with a warning instead of refusing it. Other options go to the reader (BVH: `unit`, `up`).
    Raises `FileError` with path and line, `VitruvianError` for an unknown extension or name.
    """
    path = _existing(path)
    form = extension(path)
    if form in READERS:
        return _function(READERS[form])(path, **options)
    if form not in SCENES:
        known = ", ".join(sorted({*SCENES, *READERS}))
        raise VitruvianError(f"{path}: unknown kind of file; expected one of {known}")
    found = humanoids(path, repair=repair)
    if not found:
        raise FileError(path, 0, "expected a humanoid, found none")
    if name is None:
        return found[0]
    for humanoid in found:
        if humanoid.name == name:
            return humanoid
    raise VitruvianError(
        f"{path}: expected a humanoid named {name!r}, found {', '.join(h.name or '(no name)' for h in found)}"
    )


def save(thing: Any, path: str | Path, *, hanim: str | None = None, **options: Any) -> dict[str, Any]:
    """Write a Humanoid, Clip, Body, Motion or Mesh by the extension of `path`, whole or not at all.

    `hanim` "2.0", "200x" or "1.1" picks the H-Anim version of scene files and builds them afresh. Without it, a humanoid
    that came from a file of the same family goes back into its own scene graph, so that what we don't know survives;
    others become 2.0 in X3D and 200x in VRML97.
    Returns a report: {"lost": [what the format can't hold], "pruned_weights": vertices, "max_vertex_error_m": m}.
    """
    from vitruvian.motion.types import Motion
    from vitruvian.stage.clip import Mesh

    path = Path(path)
    form = extension(path)
    if form not in WRITERS:
        raise VitruvianError(f"{path}: can't write this kind of file; expected one of {', '.join(WRITERS)}")
    if not path.parent.is_dir():
        raise VitruvianError(f"{path}: the folder {path.parent} does not exist")
    report: dict[str, Any] = {"lost": [], "pruned_weights": 0, "max_vertex_error_m": 0.0}
    if form == ".bvh":
        from vitruvian.formats.bvh import write_bvh

        motion = thing if isinstance(thing, Motion) else _clip(thing, path).motion
        if motion is None:
            raise VitruvianError(f"{path}: expected a motion to write, found none")
        write_bvh(motion, path)
        if not isinstance(thing, Motion):
            report["lost"].append("everything but the skeleton and its motion")
    elif isinstance(thing, Motion):
        raise VitruvianError(f"{path}: a motion alone can be written as .bvh; apply it to a body for {form}")
    elif form == ".glb":
        from vitruvian.formats.glb import write_glb

        report |= write_glb(thing if isinstance(thing, Mesh) else _clip(thing, path), path, **options)
    elif form == ".obj":
        from vitruvian.formats.obj import write_obj

        report |= write_obj(thing if isinstance(thing, Mesh) else _clip(thing, path), path, **options)
    elif isinstance(thing, Mesh):
        raise VitruvianError(f"{path}: a mesh without skeleton can be written as .glb or .obj")
    else:
        report["lost"] += _save_scene(thing, path, form, hanim)
    return report


def _clip(thing: Any, path: Path) -> Any:
    """`thing` as a Clip: a Humanoid brings the animation of its own file."""
    from vitruvian.body.pack import pack
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.motion.tracks import motion_of
    from vitruvian.stage.clip import Clip

    if isinstance(thing, Clip):
        return thing
    if isinstance(thing, Humanoid):
        body = pack(thing)
        return Clip(thing, body, motion_of(thing, body.skeleton))
    raise VitruvianError(f"{path}: can't write a {type(thing).__name__}; expected a Humanoid, Clip, Motion or Mesh")


def _save_scene(thing: Any, path: Path, extension: str, hanim: str | None) -> list[str]:
    from vitruvian.hanim.build import scene_of
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.stage.clip import Clip

    if isinstance(thing, Clip):
        humanoid = thing.humanoid
        if thing.motion is not None:
            from vitruvian.motion.tracks import tracks_of

            humanoid = replace(humanoid, tracks=tracks_of(thing.motion), motions=[])
    elif isinstance(thing, Humanoid):
        humanoid = thing
    else:
        raise VitruvianError(f"{path}: can't write a {type(thing).__name__}; expected a Humanoid or a Clip")
    humanoid, before = _without_newer_joints(humanoid, extension, hanim)
    built, lost = scene_of([humanoid], version=hanim, encoding=extension[1:])
    write_scene(built, path)
    return before + lost


def _without_newer_joints(humanoid: Humanoid, extension: str, hanim: str | None) -> tuple[Humanoid, list[str]]:
    """What an older version of the standard can hold of an animated body: motion of joints that it lacks is carried."""
    from vitruvian.hanim import tables

    version = hanim or ("200x" if extension == ".wrl" else "2.0")
    same = hanim is None and humanoid.scene is not None and (humanoid.scene.encoding == "wrl") == (extension == ".wrl")
    newer = any(tables.canonical(j.name) and tables.name_in(j.name, version) is None for j in humanoid.joints())
    if same or not newer or not (humanoid.tracks or humanoid.motions):
        return humanoid, []
    from vitruvian.motion.lowering import lowered

    humanoid, lost, _ = lowered(humanoid, version)
    return humanoid, lost


def write_scene(graph: Scene, path: str | Path) -> None:
    """Write a scene graph in its own encoding."""
    if graph.encoding == "x3d":
        from vitruvian.formats.x3d import write_x3d

        write_x3d(graph, path)
    else:
        from vitruvian.formats.vrml import write_vrml

        write_vrml(graph, path)


def check(path: str | Path) -> list[Finding]:
    """What is wrong in an H-Anim file and what to do about it. A file that can't be read is a finding."""
    from vitruvian.hanim.doctor import check as examine
    from vitruvian.hanim.doctor import unreadable

    try:
        return examine(scene(path), path)
    except FileError as e:
        return [unreadable(e)]


def fix(path: str | Path, out: str | Path) -> list[str]:
    """Repair what has one right repair in an H-Anim file and write it in the same encoding; one line a repair."""
    from vitruvian.hanim.doctor_fix import mend

    graph = scene(path)
    done = mend(graph, path)
    if extension(Path(out)) != f".{graph.encoding}":
        raise VitruvianError(f"{out}: a repaired file keeps its encoding; expected .{graph.encoding}")
    write_scene(graph, out)
    return done
