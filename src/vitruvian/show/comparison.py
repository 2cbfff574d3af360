"""One pose under several deformers side by side, striped, with the numbers of `deform.quality` as captions."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.pack import pack
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Body, Floats, Skeleton, require
from vitruvian.deform.deformer import NAMES, deformer
from vitruvian.deform.quality import Gauge, Quality, Report, turned
from vitruvian.errors import VitruvianError
from vitruvian.formats.atomic import atomic
from vitruvian.show.camera import Camera, fit
from vitruvian.show.figure import Figure
from vitruvian.show.picture import aim, floor_of
from vitruvian.show.render import Pixels, render, whole
from vitruvian.show.shade import KINDS, kind_of
from vitruvian.show.surfaces import Surface
from vitruvian.stage.clip import Clip

if TYPE_CHECKING:
    from vitruvian.hanim.humanoid import Humanoid

Pose = Mapping[str, Sequence[float]]
COMPARED = ("linear", "log", "volume", "contours")
CLOSE = 4  # joints that get a picture of their own
MOST = 32  # joints that are measured
_CLAY = (0.86, 0.80, 0.74)
_INK, _FAINT, _BAD, _PAPER = (38, 40, 44), (112, 115, 120), (186, 52, 28), (250, 249, 247)


@dataclass(frozen=True, eq=False)
class Posed:
    """A body in a pose under one deformer: joint matrices (J,4,4), points (V,3), what it measures."""

    name: str
    figure: Figure
    body: Body
    matrices: Floats
    gauge: Gauge
    report: Report


def compare(
    humanoid: Humanoid,
    path: str | os.PathLike[str] | None,
    *,
    deformers: Sequence[str] = COMPARED,
    pose: Pose | None = None,
    view: str = "three-quarter",
    size: tuple[int, int] = (340, 500),
    samples: int = 4,
    stripes: bool = True,
) -> dict[str, Report]:
    """Measures a pose under several deformers, and draws them side by side as a PNG (`path` None: only measures).

    deformers: names of `deform.deformer.NAMES`; for "contours", a humanoid without contour surfaces is sliced into
    them first. pose: {joint: [x, y, z, angle]}, radians; None: `default_pose`. view: as for `picture`; size of each
    figure in pixels. stripes: bands across the limbs and stripes along them, which break where a seam opens or slips,
    instead of the figure's own looks. Above each column the whole figure, below it the joints that turn most, from the
    side.
    Raises VitruvianError for unknown deformers and joints, and for another ending than .png.
    """
    size = whole(size)
    require(bool(deformers), "compare", "at least one deformer", "none")
    for name in deformers:
        if name not in NAMES:
            raise VitruvianError(f"compare: expected deformers out of {', '.join(NAMES)}, found {name!r}")
    if path is not None and os.path.splitext(os.fspath(path))[1].lower() != ".png":
        raise VitruvianError(f"{path}: expected a name that ends in .png")
    base = pack(humanoid)
    require(len(base.skin.triangles) > 0, "compare", "a figure with a surface", "none")
    chosen = default_pose(base.skeleton) if pose is None else pose
    columns = []
    for name in dict.fromkeys(deformers):
        source, body = (humanoid, base) if name != "contours" or base.contours else _sliced(humanoid)
        columns.append(_posed(source, body, name, chosen))
    if path is not None:
        _draw(columns, path, view, size, samples, stripes)
    return {c.name: c.report for c in columns}


def _sliced(humanoid: Humanoid) -> tuple[Humanoid, Body]:
    from vitruvian.modeling.contours import contours

    made = contours(humanoid)
    return made, pack(made)


def _posed(humanoid: Humanoid, body: Body, name: str, pose: Pose) -> Posed:
    s = body.skeleton
    rotation = s.rotation.copy()
    for joint, value in pose.items():
        if joint not in s.index:
            raise VitruvianError(f"pose: {joint} is not a joint of {body.name}; it has {', '.join(s.names[:8])} ...")
        rotation[s.index[joint]] = from_axis_angle(np.asarray(value, np.float64))
    body = replace(body, skeleton=replace(s, rotation=rotation))
    matrices = joint_matrices(body.skeleton)[0]
    gauge = Gauge(body, turned(body.skeleton, matrices)[:MOST])
    points = deformer(name, body)(matrices)
    return Posed(name, Figure(Clip(humanoid, body, None, name)), body, matrices, gauge, gauge.measure(points, matrices))


def default_pose(skeleton: Skeleton) -> dict[str, list[float]]:
    """A pose that asks much of a deformer: left elbow and knee bent far, right arm lifted, its hand turned over.

    {joint: [x, y, z, angle]}; the axes come from the bones at rest. Raises VitruvianError naming a joint that lacks.
    """
    index, centers = skeleton.index, skeleton.centers

    def named(*names: str) -> str:
        found = next((n for n in names if n in index), None)
        if found is None:
            raise VitruvianError(f"pose: this figure has no {names[0]}; give a pose of your own")
        return found

    wrists = {side: named(f"{side}_radiocarpal", f"{side}_wrist") for side in "lr"}
    ankle = named("l_talocrural", "l_ankle")
    chain = {"l_hip": "l_knee", "l_knee": ankle, "r_shoulder": "r_elbow", "l_elbow": wrists["l"]}
    bone = {a: centers[index[named(b)]] - centers[index[named(a)]] for a, b in chain.items()}
    bone = {a: b / max(float(np.linalg.norm(b)), 1e-9) for a, b in bone.items()}

    def bent(joint: str, towards: Sequence[float], degrees: float) -> list[float]:
        axis = np.cross(bone[joint], towards)
        size = float(np.linalg.norm(axis))
        return [*(axis / size).tolist(), float(np.radians(degrees))] if size > 1e-6 else [1.0, 0.0, 0.0, 0.0]

    lifted = float(np.degrees(np.arccos(np.clip(-bone["r_shoulder"][0], -1, 1))))
    twist = centers[index[wrists["r"]]] - centers[index[named("r_elbow")]]
    return {
        "l_hip": bent("l_hip", (0, 0, 1), 60),
        "l_knee": bent("l_knee", (0, 0, -1), 110),
        "r_shoulder": bent("r_shoulder", (-1, 0, 0), max(lifted - 10, 0)),
        "l_elbow": bent("l_elbow", (0, 0, 1), 115),
        wrists["r"]: [*(twist / max(float(np.linalg.norm(twist)), 1e-9)).tolist(), float(np.radians(120))],
    }


def chequered(surface: Surface, places: Floats) -> Surface:
    """The surface with bands across its limbs and stripes along them, all over skin and clothes; places (V,3) as of
    `limb_places`.

    The pattern goes by the bones at rest, not by texture coordinates: where a seam opens or slips, it breaks.
    """
    if len(surface.vertices) != len(places):  # bones are drawn as well
        return surface
    keep = {"eye", "hair", "gloss"}
    parts = tuple(
        p if KINDS[kind_of(p.name)] in keep else replace(p, name="checked", color=_CLAY, roughness=0.6, picture=None)
        for p in surface.parts
    )
    colors = None
    if surface.colors is not None:
        colors = surface.colors.copy()
        for p in parts:
            if p.name == "checked":
                colors[np.unique(surface.triangles[p.start : p.stop])] = _CLAY
    return replace(surface, parts=parts, colors=colors, rest=places)


def limb_places(body: Body, points: Floats) -> Floats:
    """(n,3) for points (n,3) on or near the body at rest: metres along the bones, downwards, and across them forwards
    and sideways. Each joint has a frame of its own, and the weights of the nearest vertices blend them.
    """
    from scipy.spatial import cKDTree

    s, w = body.skeleton, body.skin.weights
    down, along = np.zeros((len(s), 3)), np.zeros(len(s))
    load = np.bincount(w.joint, w.weight, minlength=len(s))
    for j in range(len(s) - 1, 0, -1):
        if s.parents[j] >= 0:
            load[s.parents[j]] += load[j]
    for j, parent in enumerate(s.parents):
        below = np.flatnonzero(s.parents == j)
        bone = s.centers[below[np.argmax(load[below])]] - s.centers[j] if len(below) else np.zeros(3)
        size = float(np.linalg.norm(bone))
        if size > 1e-6:
            down[j] = bone / size * (-1 if bone[1] > 0.5 * size else 1)
        else:
            down[j] = down[parent] if parent >= 0 else (0, -1, 0)
        if parent >= 0:
            along[j] = along[parent] + (s.centers[j] - s.centers[parent]) @ down[parent]
    ahead = np.where(np.abs(down[:, 2:]) < 0.8, [[0, 0, 1.0]], [[0, 1.0, 0]])
    ahead = ahead - (ahead * down).sum(axis=1, keepdims=True) * down
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    frame = np.stack([down, ahead, np.cross(down, ahead)], axis=1)
    offset = along[:, None] * [1.0, 0, 0] - np.einsum("jab,jb->ja", frame, s.centers)
    share = w.weight / np.where(w.sums > 0, w.sums, 1)[w.vertex]
    maps = (share[:, None, None] * np.concatenate([frame, offset[:, :, None]], axis=2)[w.joint]).reshape(-1, 12)
    maps = np.stack([np.bincount(w.vertex, maps[:, k], minlength=len(w)) for k in range(12)], axis=1)
    distance, nearest = cKDTree(body.skin.rest).query(points, k=min(4, len(w)))
    near = 1 / (distance.reshape(len(points), -1) + 1e-5) ** 2
    near /= near.sum(axis=1, keepdims=True)
    mean = np.einsum("nk,nka->na", near, maps[nearest.reshape(near.shape)]).reshape(-1, 3, 4)
    return np.einsum("nab,nb->na", mean[:, :, :3], points) + mean[:, :, 3]


def _draw(
    columns: Sequence[Posed],
    path: str | os.PathLike[str],
    view: str,
    size: tuple[int, int],
    samples: int,
    stripes: bool,
) -> None:
    from PIL import Image

    first = columns[0]
    surfaces = [next(iter(c.figure.at([0.0]))) for c in columns]
    cameras = [(size, aim(first.figure, surfaces[0], view, 0.0, size)[0], "")]
    half = (size[0], round(size[0] * 0.72))
    cameras += [(half, _beside(first, surfaces[0], joint, half), joint) for joint in _closest(columns)]
    # figures come in all sizes: what is drawn has that of a person, so that bands and light suit it
    scale, own = (1.75 / _extent(points) for points in (surfaces[0].vertices, first.body.skin.rest))
    ground = floor_of(first.figure, surfaces[0]) * scale
    cameras = [(frame, _scaled(camera, scale), joint) for frame, camera, joint in cameras]
    for i, (column, surface) in enumerate(zip(columns, surfaces)):
        surfaces[i] = replace(surface, vertices=surface.vertices * scale)
        if stripes:
            surfaces[i] = chequered(surfaces[i], limb_places(first.body, column.body.skin.rest) * own)
    strips = []
    for column, surface in zip(columns, surfaces):
        rows = [_title(column.name, size[0])]
        for frame, camera, joint in cameras:
            rows.append(render([surface], camera, frame, samples=samples, floor=ground))
            rows.append(_caption(column.report, joint, size[0]))
        strips.append(np.concatenate(rows, axis=0))
    gap = np.full((len(strips[0]), 6, 3), _PAPER, np.uint8)
    sheet = np.concatenate([piece for strip in strips for piece in (strip, gap)][:-1], axis=1)
    sheet = np.concatenate([sheet, _legend(sheet.shape[1])], axis=0)
    with atomic(path) as temporary:
        Image.fromarray(sheet).save(temporary, format="PNG", compress_level=6)


def _extent(points: Floats) -> float:
    return max(float(np.ptp(points, axis=0).max()), 1e-6)


def _scaled(camera: Camera, scale: float) -> Camera:
    x, y, z = (v * scale for v in camera.eye)
    a, b, c = (v * scale for v in camera.target)
    return replace(camera, eye=(x, y, z), target=(a, b, c))


def _closest(columns: Sequence[Posed]) -> list[str]:
    """The joints that turn most among those that every column could measure."""
    shared = [j for j in columns[0].report.joints if all(j in c.report.joints for c in columns)]
    return [j for j in shared if all(np.isfinite(c.report.joints[j].bulge) for c in columns)][:CLOSE]


def _beside(column: Posed, surface: Surface, joint: str, size: tuple[int, int]) -> Camera:
    """A camera that looks along the axis about which the joint is bent, or from the front at a joint that twists."""
    from vitruvian.body.rotations import from_matrix, to_vector

    region = column.gauge.regions[joint]
    parent, own = column.matrices[region.parent], column.matrices[region.joint]
    turn = to_vector(from_matrix(own[:3, :3] @ parent[:3, :3].T))
    line = region.line.moved(parent, own)
    bone = line.on - line.back if np.linalg.norm(line.on - line.back) > 0.2 else line.on
    bone = bone / np.linalg.norm(bone)
    place = column.body.placement
    front = place[:3, :3] @ np.array([0, 0, 1.0])
    axis = turn / max(float(np.linalg.norm(turn)), 1e-9)
    if abs(axis @ line.back) > 0.7:  # twisted
        axis = np.array([0, 0, 1.0]) - bone[2] * bone
        axis /= max(float(np.linalg.norm(axis)), 1e-9)
    axis = place[:3, :3] @ axis
    outward = place[:3, :3] @ (line.joint * [1, 0, 0])
    if axis @ (outward + 0.05 * front) < 0:
        axis = -axis
    toward = axis + 0.35 * front + 0.12 * np.array([0, 1.0, 0])
    points = surface.vertices[: len(region.vertices)][region.vertices]
    around = line.joint + 0.8 * max(region.reach) * np.concatenate([np.eye(3), -np.eye(3)])  # when one bone is short
    points = np.concatenate([points, around @ place[:3, :3].T + place[:3, 3]])
    return fit(points, toward / np.linalg.norm(toward), size, margin=0.12)


# What makes a number red in a caption: figures that a reader would call a defect.
_AIMS: dict[str, tuple[str, str, Any]] = {
    "volume": ("volume", "{:.3f}", lambda v: abs(v - 1) > 0.03),
    "area": ("least area", "{:.2f}", lambda v: v < 0.95),
    "thickness": ("thickness", "{:.2f}", lambda v: v < 0.95),
    "bulge": ("bulge", "{:.2f}", lambda v: v > 1.05),
    "folds": ("folds", "{:d}", lambda v: v > 0),
    "gap": ("seam gap", "{:.2f} mm", lambda v: v > 1e-5),
    "stretch": ("stretch", "{:.1f}", lambda v: False),
}
_LEGEND = (
    "Ratios to the pose at rest. Red: volume off by more than 0.03, area or thickness below 0.95, bulge above 1.05, "
    "any fold or gap."
)


def _text(width: int, height: int) -> tuple[Any, Any]:
    from PIL import Image, ImageDraw

    image = Image.new("RGB", (width, height), _PAPER)
    return image, ImageDraw.Draw(image)


def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)


def _title(name: str, width: int) -> Pixels:
    image, draw = _text(width, 40)
    draw.text((12, 9), name, _INK, font=_font(20))
    return np.asarray(image)


def _caption(report: Report, joint: str, width: int) -> Pixels:
    """The whole figure's numbers, or those round a joint, in two columns."""
    row: Quality = report.joints[joint] if joint else report.whole
    shown = list(_AIMS.items())
    image, draw = _text(width, 32 + 20 * ((len(shown) + 1) // 2))
    draw.text((12, 6), joint or "whole figure", _INK, font=_font(14))
    for i, (field, (label, form, bad)) in enumerate(shown):
        value = getattr(row, field)
        x, y = 12 + (i % 2) * (width // 2), 26 + 20 * (i // 2)
        known = value == value
        text = form.format(value * 1000 if field == "gap" else value) if known else "-"
        draw.text((x, y), label, _FAINT, font=_font(14))
        draw.text((x + 84, y), text, _BAD if known and bad(value) else _INK, font=_font(14))
    return np.asarray(image)


def _legend(width: int) -> Pixels:
    font = _font(13)
    lines, line = [], ""
    for word in _LEGEND.split():
        longer = f"{line} {word}".strip()
        if line and font.getlength(longer) > width - 24:
            lines.append(line)
            longer = word
        line = longer
    lines.append(line)
    image, draw = _text(width, 14 + 18 * len(lines))
    for i, one in enumerate(lines):
        draw.text((12, 6 + 18 * i), one, _FAINT, font=font)
    return np.asarray(image)
