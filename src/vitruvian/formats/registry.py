"""`load`, `save` and `check`: by extension, one table."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vitruvian.errors import FileError, VitruvianError, warn
from vitruvian.formats.scenes import clip_of, save_baked, save_scene

if TYPE_CHECKING:
    from vitruvian.hanim.doctor import Finding
    from vitruvian.hanim.graph import Scene
    from vitruvian.hanim.humanoid import Humanoid

GARMENTCODE, PATTERN, FREESEWING = ".garmentcode.json", ".pattern.json", ".freesewing.json"  # what .json may be
# extension -> module and function; scenes hold humanoids, the others answer their noun at once
SCENES = {
    ".x3d": ("x3d", "read_x3d"),
    ".x3dv": ("vrml", "read_vrml"),
    ".wrl": ("vrml", "read_vrml"),
    ".wrz": ("vrml", "read_vrml"),
    ".x3dj": ("x3d_json", "read_json"),
}
# A .json file is what its key on top says: key -> extension of the same kind
JSON_KINDS = {"X3D": ".x3dj", "pattern": GARMENTCODE, "vitruvian_pattern": PATTERN, "parts": FREESEWING}
READERS = {
    ".bvh": ("bvh", "read_bvh"),
    ".amc": ("asf", "read_amc"),
    ".asf": ("asf", "read_asf"),
    ".npz": ("amass", "read_amass"),
    ".c3d": ("c3d", "read_c3d"),
    ".trc": ("trc", "read_trc"),
    ".csm": ("csm", "read_csm"),
    ".mot": ("storage", "read_storage"),
    ".sto": ("storage", "read_storage"),
    ".osim": ("osim", "read_osim"),
    GARMENTCODE: ("garmentcode", "read_garmentcode"),
    PATTERN: ("pattern_file", "read_pattern"),
    FREESEWING: ("freesewing", "read_freesewing"),
    ".svg": ("freesewing", "read_svg"),
    ".dxf": ("pattern_dxf", "read_dxf"),
    ".obj": ("obj", "read_obj"),
    ".ply": ("obj", "read_mesh"),
    ".stl": ("obj", "read_mesh"),
}
# What can be said about a capture file that does not say it itself, by extension
SAYABLE = {
    ".bvh": {"unit", "up"},
    ".amc": {"unit", "up", "fps", "skeleton"},
    ".asf": {"unit", "up"},
    ".npz": {"up", "fps"},
    **dict.fromkeys((".c3d", ".trc", ".csm"), {"unit", "up", "fps", "actor"}),
}
MARKERS = (".trc", ".csm")  # written; .c3d is read only
MOTIONS = (".bvh", ".vrma", ".amc", ".npz", *MARKERS)
# files that hold humanoids, a motion or a mesh: only reading them tells which
FIGURES = dict.fromkeys((".glb", ".gltf", ".vrm", ".vrma"), ("gltf_reader", "read_all"))
USD = (".usda", ".usdc", ".usd", ".usdz")
WRITERS = (
    ".x3d",
    ".x3dv",
    ".wrl",
    ".x3dj",
    ".json",
    ".glb",
    ".vrm",
    ".vrma",
    ".bvh",
    ".amc",
    ".npz",
    *MARKERS,
    ".obj",
    ".objs",
    *USD,
)
CACHE = ".cache.npz"


def _function(where: tuple[str, str]) -> Callable[..., Any]:
    return getattr(import_module(f"vitruvian.formats.{where[0]}"), where[1])


def extension(path: Path) -> str:
    suffixes = [s.lower() for s in path.suffixes]
    return suffixes[-2] if suffixes[-1:] == [".gz"] and len(suffixes) > 1 else (suffixes or [""])[-1]


def kind(path: str | Path) -> str:
    """The extension that says how to read a file: its own or, for .json, that of what the file's top holds.

    FileError for a .json file of which nobody knows the kind.
    """
    path = Path(path)
    form = extension(path)
    if form != ".json":
        return form
    from vitruvian.formats.json_tree import top_keys

    keys = top_keys(_existing(path))
    for key in keys:
        if key in JSON_KINDS:
            return JSON_KINDS[key]
    wanted = " or ".join(f'{{"{key}": ...}}' for key in JSON_KINDS)
    found = ", ".join(repr(key[:30]) for key in keys[:4]) or "no object with keys"
    raise FileError(path, 1, f"expected {wanted} at the top of a .json file, found {found}")


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
    where = SCENES.get(kind(path))
    if where is None:
        raise VitruvianError(f"{path}: expected a scene ({', '.join(sorted(SCENES))})")
    return _function(where)(path)


def humanoids(path: str | Path, *, repair: bool = False) -> list[Humanoid]:
    """All humanoids of a scene, glTF or USD file, in source order; [] when it holds none."""
    if extension(_existing(path)) in (*FIGURES, *USD):
        return [thing for thing in contents(path) if hasattr(thing, "skin_coord")]
    from vitruvian.hanim.view import humanoids as view

    return view(scene(path), path, repair=repair)


def contents(path: str | Path, *, repair: bool = False, **options: Any) -> list[Any]:
    """Everything that a file holds: its humanoids, those of a USD file and then its other surfaces as one Mesh, or the one
    thing that other files are. Errors and options as for `load`."""
    path = _existing(path)
    form = kind(path)
    if path.name.lower().endswith(CACHE):
        from vitruvian.formats.cache_file import read_caches

        return [read_caches(path)]
    if form in SCENES:
        return list(humanoids(path, repair=repair))
    if form in READERS:
        return [_function(READERS[form])(path, **options)]
    if form in FIGURES:
        found = _function(FIGURES[form])(path, **options)
        return found if isinstance(found, list) else [found]
    if form in USD:
        from vitruvian.formats.usd_reader import read_usd

        return list(read_usd(path))
    known = ", ".join(sorted({*SCENES, *FIGURES, *READERS, *USD, ".json"}))
    raise VitruvianError(f"{path}: unknown kind of file; expected one of {known}")


def load(path: str | Path, *, name: str | None = None, repair: bool = False, **options: Any) -> Any:
    """What a file holds, by its extension: `Humanoid` (.x3d .x3dv .x3dj .wrl, .usd*), `Motion` (.bvh .amc .npz),
    `Markers` (.c3d .trc .csm), `Storage` (.mot .sto), `Mechanism` (.osim) or `Mesh` (.obj .ply .stl);
    glTF (.glb .gltf .vrm .vrma) may hold a humanoid, a motion or a mesh. A .json file is what the key on its top says:
    {"X3D": ...} is a scene, {"pattern": ...} a `Pattern` of GarmentCode, {"parts": ...} one of FreeSewing,
    {"vitruvian_pattern": ...} one of ours; .svg and .dxf drawings are patterns too. NAME.cache.npz holds a tuple of
    `VertexCache`.

    `name` picks one of several humanoids. `repair` drops what can't be meant (non-finite numbers, indices outside their
    array) with a warning instead of refusing it. Other options go to the reader (captures: `unit`, `up`, `fps`, `actor`,
    `skeleton`, see `SAYABLE`; glTF: `names`).
    Raises `FileError` with path and line, `VitruvianError` for an unknown extension or name.
    """
    found = contents(path, repair=repair, **options)
    form = kind(Path(path))
    if form in READERS or (form in FIGURES and found and not hasattr(found[0], "skin_coord")):
        return found[0]
    if not found:
        raise FileError(path, 0, "expected a humanoid, found none")
    if name is None:
        if len(found) > 1 and form not in SCENES:
            warn(f"{path}: also holds {', '.join(t.name or '(no name)' for t in found[1:4])}; name= picks one")
        return found[0]
    for humanoid in found:
        if humanoid.name == name:
            return humanoid
    raise VitruvianError(
        f"{path}: expected a humanoid named {name!r}, found {', '.join(h.name or '(no name)' for h in found)}"
    )


def save(
    thing: Any, path: str | Path, *, hanim: str | None = None, clip: str | None = None, **options: Any
) -> dict[str, Any]:
    """Write a Humanoid, Clip, Body, Motion or Mesh by the extension of `path`, whole or not at all.

    A Motion alone goes into .bvh, .vrma, .amc (with its .asf), .npz, or as the tracks of joints and Sites into .trc and
    .csm, which take Markers too; .vrm takes humanoids that have the fifteen bones VRM needs.
    Scene files are .x3d (XML), .x3dv (Classic), .x3dj or .json (JSON) and .wrl (VRML97). They also take a list of
    Humanoids and Clips: several figures, and several clips of one figure. Their options: `motion` "interpolators" or
    "hanimmotion" (X3D 4.0) says how clips are written, `draft` writes X3D 4.1 as drafted. `bake` writes, for viewers
    that do not skin, the points of the skin as keys of a CoordinateInterpolator, fewest that are within `tolerance`
    (metres) of every frame; the report then has `baked` (see `formats.bake`). USD takes `bake` too: every frame.

    `hanim` "2.0", "200x" or "1.1" picks the H-Anim version of scene files and builds them afresh. Without it, a humanoid
    that came from a file of the same family goes back into its own scene graph, so that what we don't know survives;
    others become 2.0 in X3D and 200x in VRML97.
    A Clip in a garment: the cloth moves in .glb (morph targets), scenes (CoordinateInterpolator) and USD (time samples)
    with the body as those move it, within `tolerance` (metres, 0.002), and the report has `cloth`; NAME.objs is a folder of
    an OBJ for each frame, NAME.cache.npz the moving clothes alone. See `vitruvian.stage.baking.bake`.
    `clip` names the animation of a Humanoid's own file that files with one motion (.glb .bvh .obj) get.
    A Pattern is written as .pattern.json, or drawn as .svg or .dxf.
    Returns a report: {"lost": [what the format can't hold], "pruned_weights": vertices, "max_vertex_error_m": m}.
    """
    from vitruvian.cloth.pattern import Pattern
    from vitruvian.motion.markers import Markers
    from vitruvian.motion.types import Motion
    from vitruvian.stage.clip import Mesh

    path = Path(path)
    form = extension(path)
    if isinstance(thing, Pattern):
        from vitruvian.formats.pattern_file import write_any

        return {"lost": write_any(thing, path), "pruned_weights": 0, "max_vertex_error_m": 0.0}
    if form not in WRITERS:
        raise VitruvianError(f"{path}: can't write this kind of file; expected one of {', '.join(WRITERS)}")
    if not path.parent.is_dir():
        raise VitruvianError(f"{path}: the folder {path.parent} does not exist")
    report: dict[str, Any] = {"lost": [], "pruned_weights": 0, "max_vertex_error_m": 0.0}
    if path.name.lower().endswith(CACHE):
        from vitruvian.formats.cache_file import write_caches

        report |= write_caches(_with_caches(clip_of(thing, path, clip), path).caches, path)
    elif form in MOTIONS:
        report |= _save_motion(thing, path, form, clip)
    elif isinstance(thing, Motion | Markers):
        what, fits = ("a motion", MOTIONS) if isinstance(thing, Motion) else ("markers", MARKERS)
        raise VitruvianError(f"{path}: {what} alone can be written as {', '.join(fits)}; apply it to a body for {form}")
    elif form == ".glb":
        from vitruvian.formats.glb import write_glb

        report |= write_glb(
            thing if isinstance(thing, Mesh) else _with_caches(clip_of(thing, path, clip), path), path, **options
        )
    elif form == ".vrm":
        from vitruvian.formats.vrm import write_vrm

        if isinstance(thing, Mesh):
            raise VitruvianError(f"{path}: a VRM needs a humanoid; a mesh can be written as .glb or .obj")
        report |= write_vrm(clip_of(thing, path, clip), path, **options)
    elif form in USD:
        from vitruvian.formats.usd import write_usd

        things = thing if isinstance(thing, list | tuple) else [thing]
        clips = [t if isinstance(t, Mesh) else clip_of(t, path, clip) for t in things]
        report |= write_usd(_with_caches(clips, path, bake=options.get("bake", False)), path, **options)
    elif form == ".obj":
        from vitruvian.formats.obj import write_obj

        report |= write_obj(thing if isinstance(thing, Mesh) else clip_of(thing, path, clip), path, **options)
    elif form == ".objs" and not isinstance(thing, Mesh):
        from vitruvian.formats.obj_sequence import write_sequence

        report |= write_sequence(_with_caches(clip_of(thing, path, clip), path), path)
    elif isinstance(thing, Mesh):
        raise VitruvianError(f"{path}: a mesh without skeleton can be written as .glb or .obj")
    elif options.pop("bake", False):
        report |= save_baked(_with_caches(thing, path, bake=True), path, form, hanim, clip, **options)
    else:
        report |= save_scene(_with_caches(thing, path), path, form, hanim, **options)
    garment = getattr(thing, "garment", None)
    if garment is not None and not clothed(path):
        report["lost"] = [*report["lost"], f"{garment.name}, which is worn: clothes move in .glb, scenes and USD"]
    return report


def clothed(path: str | Path) -> bool:
    """Whether moving clothes can be written into a file of this name."""
    form = extension(Path(path))
    return form in (".glb", ".json", ".objs", *SCENES, *USD) or str(path).lower().endswith(CACHE)


def shown_by(path: str | Path, deformer: str, *, bake: bool = False) -> str:
    """The deformer by which a body moves in a file of this name that was written for another one: what plays it skins
    linearly, but where deformed points are in it."""
    form = extension(Path(path))
    skins = form == ".glb" or (form in (".json", *SCENES, *USD) and not bake)
    return "linear" if skins else deformer


def _with_caches(thing: Any, path: Path, *, bake: bool = False) -> Any:
    """Clips in garments with what those do on the body as the file at `path` shows it."""
    from dataclasses import replace

    from vitruvian.stage.clip import Clip

    if isinstance(thing, list | tuple):
        return [_with_caches(t, path, bake=bake) for t in thing]
    if not isinstance(thing, Clip) or thing.garment is None or thing.caches:
        return thing
    from vitruvian.stage.baking import bake as bake_clothes

    return replace(thing, caches=bake_clothes(thing, deformer=shown_by(path, thing.deformer, bake=bake)))


def _save_motion(thing: Any, path: Path, form: str, clip: str | None) -> dict[str, Any]:
    """A Motion, that of a Clip or Humanoid, or Markers in a file that holds nothing else."""
    from vitruvian.motion.markers import Markers, markers_of
    from vitruvian.motion.types import Motion

    module, function = _MOTION_WRITERS[form]
    write = _function((module, function))
    if isinstance(thing, Markers):
        if form not in MARKERS:
            raise VitruvianError(f"{path}: markers have no joints; they can be written as {', '.join(MARKERS)}")
        return write(thing, path)
    motion = thing if isinstance(thing, Motion) else clip_of(thing, path, clip if form != ".vrma" else None).motion
    if motion is None:
        raise VitruvianError(f"{path}: expected a motion to write, found none")
    report = write(markers_of(motion) if form in MARKERS else motion, path) or {"lost": []}
    if not isinstance(thing, Motion) and form != ".vrma":
        report["lost"].append("everything but the skeleton and its motion")
    return report


_MOTION_WRITERS = {
    ".bvh": ("bvh", "write_bvh"),
    ".vrma": ("vrma", "write_vrma"),
    ".amc": ("amc_writer", "write_amc"),
    ".npz": ("amass", "write_amass"),
    ".trc": ("trc", "write_trc"),
    ".csm": ("csm", "write_csm"),
}


def write_scene(graph: Scene, path: str | Path) -> None:
    """Write a scene graph in its own encoding."""
    if graph.encoding == "x3d":
        from vitruvian.formats.x3d import write_x3d

        write_x3d(graph, path)
    elif graph.encoding == "x3dj":
        from vitruvian.formats.x3d_json import write_json

        write_json(graph, path)
    else:
        from vitruvian.formats.vrml import write_vrml

        write_vrml(graph, path)


def check(path: str | Path, *, schema: bool = False) -> list[Finding]:
    """What is wrong in an H-Anim file and what to do about it. A file that can't be read is a finding.

    `schema` asks the X3D XML schema too (half a second once).
    """
    from vitruvian.hanim.doctor import check as examine
    from vitruvian.hanim.doctor import sort, unreadable

    try:
        graph, found = _examined(path)
    except FileError as e:
        return [unreadable(e, _line(path, e.line))]
    found = found + examine(graph, path)
    if schema and graph.encoding == "x3d":
        from vitruvian.formats.schema import complaints

        found += complaints(path)
    return sort(found)


def _line(path: str | Path, number: int) -> str:
    """The text of a line of a file that could not be read, shortened; "" when it can't be shown."""
    from itertools import islice

    if number < 1:
        return ""
    try:
        with open(path, "rb") as file:
            text = next(islice(file, number - 1, None), b"")[:2000].decode("utf-8", "replace")
    except OSError:
        return ""
    text = " ".join(text.split())
    return (text if len(text) <= 80 else text[:77] + "...") if text.isprintable() else ""


def _examined(path: str | Path) -> tuple[Scene, list[Finding]]:
    """The scene of a file, read in spite of a wrong header, which is a finding (F01)."""
    if extension(_existing(path)) in (*FIGURES, *USD):
        return _as_scene(path), []
    try:
        return scene(path), []
    except FileError:
        from vitruvian.formats.header import recovered

        path = _existing(path)
        saved = recovered(path, extension(path))
        if saved is None:
            raise
        return saved


def _as_scene(path: str | Path) -> Scene:
    """The humanoid of another kind of file as a scene that the doctor can look at; its findings have no lines."""
    from vitruvian.hanim.build import scene_of

    found = humanoids(path)
    if not found:
        raise VitruvianError(f"{path}: holds a motion or a mesh; the doctor looks at humanoids only")
    return scene_of(found)[0]


def fix(path: str | Path, out: str | Path, *, also: Iterable[str] = ()) -> list[str]:
    """Repair what has one right repair in an H-Anim file and write it in the same encoding; one line a repair.

    `also` names rules that are repaired on request only, "all" for all of them.
    """
    from vitruvian.hanim.doctor_fix import mend

    graph, found = _examined(path)
    done = [f"{f.message}: written anew (F01)" for f in found]
    done += mend(graph, path, also=also)
    form = extension(Path(out))
    if form != f".{graph.encoding}" and (form, graph.encoding) != (".json", "x3dj"):
        raise VitruvianError(f"{out}: a repaired file keeps its encoding; expected .{graph.encoding}")
    write_scene(graph, out)
    return done
