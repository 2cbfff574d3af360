"""Bodies for the page that a capture moves: by a clip, with its own skeleton beside them, or by markers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from vitruvian.cli.capture import no_joints, said
from vitruvian.cli.output import progress, say
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.body.types import Body
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.motion.types import Motion
    from vitruvian.show.marked import Marked


def named(file: str) -> Any:
    """What a file holds; the word person stands for the built-in person."""
    if file == "person" and not Path(file).is_file():
        from vitruvian.modeling.person import person

        return person()
    from vitruvian.formats.registry import load

    return load(file)


def moved(
    file: str, motion: Path | None, source: bool, markers: Path | None, unit: str | None, actor: str | None
) -> list[Any]:
    """What `view` shows for its first file with --motion, --source and --markers; `unit` and `actor` of the capture."""
    from vitruvian.body.pack import pack
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.modeling.person import person
    from vitruvian.motion.retarget import retarget
    from vitruvian.motion.types import Motion
    from vitruvian.show.sticks import sticks
    from vitruvian.stage.clip import Clip

    if markers is not None and (motion is not None or source):
        raise VitruvianError("--markers: goes without --motion and --source; markers are the motion")
    thing = named(file)
    clip, name = None, Path(file).stem
    if isinstance(thing, Motion):  # a clip by itself: on the built-in person
        if motion is not None or markers is not None:
            raise VitruvianError(f"{file}: expected a body to move, found a motion; name the body first")
        clip, thing = thing, person()
    if not isinstance(thing, Humanoid):
        raise no_joints(file, thing)
    body = pack(thing)
    if markers is not None:
        return [_by_markers(thing, body, markers, unit, actor)]
    if motion is not None:
        clip, name = _motion(motion, unit), motion.stem
    if clip is None:
        raise VitruvianError("--source: goes with --motion CLIP, or with a clip alone")
    done = retarget(clip, body.skeleton)
    for note in done.notes:
        say(note)
    beside = [sticks(clip, (body.skeleton, done), name=f"{name} (source)")] if source else []
    return [Clip(thing, body, done), *beside]


def _motion(file: Path, unit: str | None) -> Motion:
    """The clip in a file: a motion, or that of a body."""
    from vitruvian.body.pack import pack
    from vitruvian.formats.registry import load
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.motion.tracks import motion_of
    from vitruvian.motion.types import Motion

    thing = load(file, **said(file, unit, None, None, None, None))
    if isinstance(thing, Humanoid):
        found = motion_of(thing, pack(thing).skeleton)
        if found is None:
            raise VitruvianError(f"{file}: expected a motion, found a body that stands still")
        return found
    if not isinstance(thing, Motion):
        raise no_joints(file, thing)
    return thing


def _by_markers(humanoid: Humanoid, body: Body, file: Path, unit: str | None, actor: str | None) -> Marked:
    from vitruvian.formats.registry import load
    from vitruvian.motion.markers import Markers
    from vitruvian.show.marked import marked

    found = load(file, **said(file, unit, None, None, actor, None))
    if not isinstance(found, Markers):
        raise VitruvianError(f"{file}: expected markers (.trc .c3d), found a {type(found).__name__.lower()}")
    with progress("markers") as update:
        own, lines = marked(humanoid, body, found, progress=lambda part: update(round(1000 * part), 1000))
    for line in lines:
        say(line)
    return own
