"""Scenes of H-Anim figures as X3D and VRML hold them: which humanoids, with what motions, skins and clothes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.stage.clip import Clip


def save_baked(
    thing: Any, path: Path, form: str, hanim: str | None, clip: str | None, *, tolerance: float | None = None
) -> dict[str, Any]:
    """A scene whose skins move by CoordinateInterpolators. The report of `save`."""
    from vitruvian.formats.bake import TOLERANCE, bake_skin

    skins = TOLERANCE if tolerance is None else tolerance

    if hanim == "1.1":
        raise VitruvianError("bake: H-Anim 1.1 has no skin; write 200x, or cut the skin into segments")
    version = hanim or ("200x" if form == ".wrl" else "2.0")
    figures, lost, baked, cloth = [], [], [], []
    for one in thing if isinstance(thing, list | tuple) else [thing]:
        moving = clip_of(one, path, clip)
        plain, tracks, facts = bake_skin(moving, tolerance=skins)
        if moving.motion is not None or moving.caches:
            (plain,), worn = _with_clips([replace(moving, humanoid=plain)], path, "interpolators", tolerance)
            plain = replace(plain, tracks=[t for t in plain.tracks if t.field != "weight"])
            cloth += worn
        fitted, gone = _without_newer_joints(plain, form, version)
        figures.append(replace(fitted, tracks=[*fitted.tracks, *tracks]))
        lost += facts.pop("lost") + gone
        baked.append(facts)
    lost += _write_figures(figures, path, form, version)
    facts = {k: max(b[k] for b in baked) for k in ("frames", "keys", "max_error_m")}
    facts |= {"points": sum(b["points"] for b in baked), "tolerance_m": skins, "bytes": path.stat().st_size}
    report = {"lost": lost, "max_vertex_error_m": facts["max_error_m"], "baked": facts}
    return report | ({"cloth": cloth, "bytes": facts["bytes"]} if cloth else {})


def clip_of(thing: Any, path: Path, clip: str | None = None) -> Any:
    """`thing` as a Clip: a Humanoid brings the animation of its own file, the one named `clip` or the first."""
    from vitruvian.body.pack import pack
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.motion.tracks import motion_of
    from vitruvian.stage.clip import Clip

    if isinstance(thing, Clip):
        return thing
    if isinstance(thing, Humanoid):
        body = pack(thing)
        return Clip(thing, body, motion_of(thing, body.skeleton, name=clip))
    raise VitruvianError(f"{path}: can't write a {type(thing).__name__}; expected a Humanoid, Clip, Motion or Mesh")


def save_scene(
    thing: Any, path: Path, extension: str, hanim: str | None, *, motion: str = "interpolators", draft: bool = False,
    tolerance: float | None = None,
) -> dict[str, Any]:  # fmt: skip
    """A scene of H-Anim figures, skinned by their viewer. The report of `save`."""
    things = list(thing) if isinstance(thing, list | tuple) else [thing]
    if not things:
        raise VitruvianError(f"{path}: expected at least one Humanoid or Clip to write, found none")
    if hanim == "1.1":
        things, bare = _undressed(things)
    else:
        bare = []
    before: list[str] = bare
    figures, cloth = _with_clips(things, path, motion, tolerance)
    humanoids = []
    for humanoid in figures:
        fitted, gone = _without_newer_joints(humanoid, extension, hanim)
        humanoids.append(fitted)
        before += gone
    lost = before + _write_figures(humanoids, path, extension, hanim, draft=draft)
    return {"lost": lost} | ({"cloth": cloth, "bytes": path.stat().st_size} if cloth else {})


def _undressed(things: list[Any]) -> tuple[list[Any], list[str]]:
    """What H-Anim 1.1 can hold of Clips: it has no skin, in which moving clothes hang."""
    names = [c.name for t in things for c in getattr(t, "caches", ())]
    bare = [replace(t, caches=()) if getattr(t, "caches", ()) else t for t in things]
    return bare, [f"moving clothes ({', '.join(names)}): H-Anim 1.1 has no skin"] if names else []


def _write_figures(
    humanoids: list[Humanoid], path: Path, extension: str, hanim: str | None, *, draft: bool = False
) -> list[str]:
    from vitruvian.formats.pictures import Addresses, staying
    from vitruvian.hanim.build import scene_of

    encoding = "x3dj" if extension == ".json" else extension[1:]
    addresses = Addresses(path, beside=encoding == "wrl")  # VRML97 browsers know no data URIs
    built, lost = scene_of(humanoids, version=hanim, encoding=encoding, draft=draft, address=addresses)
    if built is humanoids[0].scene:  # it goes back as it came, with the addresses that it has
        lost += staying(humanoids, path.parent)
    addresses.write()
    from vitruvian.formats.registry import write_scene

    write_scene(built, path)
    return lost + addresses.lost()


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


def _with_clips(
    things: list[Any], path: Path, form: str, tolerance: float | None = None
) -> tuple[list[Humanoid], list[dict[str, Any]]]:
    """The humanoids among Humanoids and Clips, each once, with the motions and the moving clothes of their Clips, and what
    there is to say of the clothes."""
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.motion.tracks import motion_data, tracks_of
    from vitruvian.stage.clip import Clip

    if form not in {"interpolators", "hanimmotion"}:
        raise VitruvianError(f"motion: expected interpolators or hanimmotion, found {form!r}")
    given: dict[int, tuple[Humanoid, list[Clip]]] = {}
    for thing in things:
        if not isinstance(thing, Clip | Humanoid):
            raise VitruvianError(f"{path}: can't write a {type(thing).__name__}; expected a Humanoid or a Clip")
        owner = thing.humanoid if isinstance(thing, Clip) else thing
        entry = given.setdefault(id(owner), (owner, []))
        if isinstance(thing, Clip) and (thing.motion is not None or thing.caches):
            entry[1].append(thing)
    out, facts = [], []
    for humanoid, clips in given.values():
        names: list[str] = []
        for c in clips:
            base = (c.motion and c.motion.name) or "clip"
            names.append(base if base not in names else f"{base}_{len(names) + 1}")
        timers = names if len(names) > 1 else [c.motion.name if c.motion else "" for c in clips]
        moved = [(c.motion, n) for c, n in zip(clips, timers) if c.motion is not None]
        if form == "hanimmotion" and moved:
            data = [replace(motion_data(m), name=n, enabled=k == 0) for k, (m, n) in enumerate(
                (c.motion, n) for c, n in zip(clips, names) if c.motion is not None)]  # fmt: skip
            tracks = [t for c, n in zip(clips, names) if c.motion is not None for t in tracks_of(c.motion, timer=n)]
            humanoid = replace(humanoid, motions=data, tracks=[t for t in tracks if t.field == "weight"])
        elif moved:
            tracks = [t for m, n in moved for t in tracks_of(m, timer=n)]
            humanoid = replace(humanoid, tracks=tracks, motions=[])
        for c, n in zip(clips, timers):
            humanoid, worn = _clothed(humanoid, c, n, tolerance)
            facts += worn
        out.append(humanoid)
    return out, facts


CLOTH = 0.002  # metres


def _clothed(
    humanoid: Humanoid, clip: Clip, timer: str, tolerance: float | None
) -> tuple[Humanoid, list[dict[str, Any]]]:
    """The humanoid with the caches of a clip as surfaces of its skin that have points of their own, and their tracks."""
    import numpy as np

    from vitruvian.formats.bake import reduced
    from vitruvian.hanim.humanoid import Material, Shape, Track
    from vitruvian.stage.vertex_cache import ROUGHNESS

    within, facts = CLOTH if tolerance is None else tolerance, []
    for cache in clip.caches:
        frames, n = cache.positions.shape[:2]
        keys, values, _, error = reduced((p.astype(np.float64) for p in cache.positions), n, within)
        taken = {s.name: s for s in humanoid.skin}
        name, k = cache.name, 2
        while name in taken and not np.array_equal(taken[name].triangles, cache.triangles):
            name, k = f"{cache.name}_{k}", k + 1
        if name not in taken:
            look = Material(name, cache.color, roughness=ROUGHNESS, double_sided=True)
            shape = Shape(name, cache.triangles, values[0], cache.uv, cache.uv_triangles, material=look)
            humanoid = replace(humanoid, skin=[*humanoid.skin, shape])
        if len(keys) > 1 and clip.motion is not None:
            fps, loop = clip.motion.fps, clip.motion.loop
            track = Track(name, "point", keys, values.reshape(len(keys), -1), (frames - 1) / fps, loop, timer, fps)
            humanoid = replace(humanoid, tracks=[*humanoid.tracks, track])
        facts.append({"name": name, "frames": frames, "points": n, "keys": len(keys), "max_error_m": error,
                      "tolerance_m": within, "closing_m": cache.closing})  # fmt: skip
    return humanoid, facts
