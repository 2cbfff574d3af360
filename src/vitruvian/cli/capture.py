"""What commands ask and say about capture files: options that stand in for what a file does not say, and facts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli.output import count
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.motion.markers import Markers, Storage
    from vitruvian.motion.mechanism import Mechanism
    from vitruvian.motion.types import Motion

Unit = typer.Option(None, "--unit", help="Captures: the file's unit: m, dm, cm, mm, in or metres per unit.")
Up = typer.Option(None, "--up", help="Captures: the file's up axis: x, y or z, - before it for downwards.")
Fps = typer.Option(None, "--fps", help="Captures that hold no rate: frames a second.")
Actor = typer.Option(None, "--actor", help="Markers: which person, by the prefix of the labels; * for all of them.")
Skeleton = typer.Option(None, "--skeleton", help="AMC: the .asf of its skeleton (default: the one beside it).")


def said(
    file: str | Path, unit: str | None, up: str | None, fps: float | None, actor: str | None, skeleton: Path | None
) -> dict[str, Any]:
    """Options of `load` for a file. Raises VitruvianError for one that this kind of file does not take."""
    from vitruvian.formats import registry

    given = {"unit": _unit(unit), "up": up, "fps": fps, "actor": actor, "skeleton": skeleton}
    given = {k: v for k, v in given.items() if v is not None}
    takes = registry.SAYABLE.get(registry.extension(Path(file)), set()) if given else set()
    for option in given:
        if option not in takes:
            known = ", ".join(sorted(f"--{t}" for t in takes)) or "none of these options"
            raise VitruvianError(f"--{option}: {file} takes {known}")
    return given


def _unit(text: str | None) -> float | str | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return text


def motion_facts(motion: Motion) -> tuple[dict[str, Any], str]:
    """For `info`: a document and a line for each thing."""
    facts = {
        "joints": len(motion.skeleton),
        "frames": len(motion),
        "fps": motion.fps,
        "seconds": motion.seconds,
        "notes": list(motion.notes),
    }
    text = f"motion: {facts['joints']} joints, {facts['frames']:,} frames at {motion.fps:g} per second"
    return facts, "\n".join([text, *(f"  {note}" for note in motion.notes)])


def marker_facts(markers: Markers) -> tuple[dict[str, Any], str]:
    """For `info`: labels and their gaps, rate, unit, axis, length, who is in it."""
    gaps = {name: round(100 * float(share), 2) for name, share in zip(markers.names, markers.missing)}
    total = round(100 * float(markers.missing.mean()), 2)
    people = {who: len(index) for who, index in markers.actors.items()}
    facts = {
        "markers": len(markers.names),
        "frames": len(markers),
        "fps": markers.fps,
        "seconds": markers.seconds,
        "first_frame": markers.first,
        "start_s": markers.start,
        "unit_m": markers.unit,
        "up": markers.up,
        "gaps_percent": total,
        "labels": gaps,
        "actors": people,
        "events": [list(e) for e in markers.events],
        "analog": list(markers.analog),
        "analog_fps": markers.analog_fps,
        "notes": list(markers.notes),
    }
    lines = [
        f"markers: {len(markers.names)}, {len(markers):,} frames at {markers.fps:g} per second from frame "
        f"{markers.first} ({markers.seconds:.3f} s), {total:g} % of the points missing"
    ]
    lines += [f"  {note}" for note in markers.notes]
    lines += [f"  {who}: {count(n, 'marker')} (choose with --actor)" for who, n in people.items()]
    if markers.analog:
        lines.append(f"  {len(markers.analog)} analog channels at {markers.analog_fps:g} per second")
    lines += [f"  event {name} at {t:.3f} s" for t, name in markers.events]
    wide = max(map(len, markers.names))
    lines += [f"  {name:<{wide}}  {gap:6.2f} % missing" for name, gap in gaps.items()]
    return facts, "\n".join(lines)


def table_facts(table: Storage) -> tuple[dict[str, Any], str]:
    """For `info`: the columns of a MOT or STO file."""
    seconds = float(table.times[-1] - table.times[0])
    facts = {
        "columns": list(table.columns),
        "rows": len(table),
        "fps": table.fps,
        "seconds": seconds,
        "degrees": table.degrees,
        "notes": list(table.notes),
    }
    text = f"table: {count(len(table.columns), 'column')}, {len(table):,} rows at {table.fps:g} per second"
    return facts, "\n".join([text, *(f"  {note}" for note in table.notes), f"  {', '.join(table.columns)}"])


def mechanism_facts(model: Mechanism) -> tuple[dict[str, Any], str]:
    """For `info`: bodies, coordinates and markers of an OpenSim model."""
    facts = {
        "bodies": [link.name for link in model.links],
        "coordinates": list(model.coordinates),
        "markers": list(model.markers),
    }
    text = f"model: {', '.join(f'{len(v)} {k}' for k, v in facts.items())}"
    return facts, "\n".join([text, *(f"  {k}: {', '.join(v)}" for k, v in facts.items())])


def no_joints(source: str | Path, thing: object) -> VitruvianError:
    """What to say when a motion of joints was wanted and something else is there."""
    what = {
        "Markers": "markers, which have no joints yet; `vitruvian solve` finds them",
        "Storage": "a table of numbers, without a skeleton",
        "Mechanism": "a model",
    }
    found = what.get(type(thing).__name__, "none in it")
    return VitruvianError(f"{source}: expected a motion of joints, found {found}")


# the noun that a reader answers -> key of the document, and what to say
FACTS: dict[str, tuple[str, Callable[[Any], tuple[dict[str, Any], str]]]] = {
    "Motion": ("motion", motion_facts),
    "Markers": ("markers", marker_facts),
    "Storage": ("table", table_facts),
    "Mechanism": ("mechanism", mechanism_facts),
}
