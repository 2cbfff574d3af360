"""From a scan to an animatable humanoid: a template is brought to the scan's size, pose and shape.

Stages: similarity by landmarks; joint parameters by landmarks; sliders of the built-in person and joint parameters by the
surface, from a grown person and from a young one; hands by themselves; free offsets; back to the dress pose, where the
skin's weights hold again.
Sources: seed 003, sections 3.1 and 3.2; H. Seo, N. Magnenat-Thalmann, "An Automatic Modeling of Human Bodies from Sizing
Parameters" (2003); note body.md, section 3.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.pack import pack
from vitruvian.body.threads import one_thread
from vitruvian.body.types import Floats, floats, indices
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling import bones as bo
from vitruvian.modeling import fingers, shrink
from vitruvian.modeling.bones import Bones, Rows
from vitruvian.modeling.crossings import uncrossed
from vitruvian.modeling.features import feature_name
from vitruvian.modeling.landmarks import detect, still
from vitruvian.modeling.likeness import Likeness, improved, on_scan, shape_of, values_of
from vitruvian.modeling.rebinding import rested_body, rested_person
from vitruvian.modeling.shape import Shape
from vitruvian.modeling.template import Template, body_template, person_template
from vitruvian.modeling.transfer import Surface
from vitruvian.motion.types import Motion

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "dm": 0.1, "ft": 0.3048}
SIZES = (0.45, 1.6)  # of a person against the template
SMALLEST, OF_TEN, TALLEST = 0.69, 0.80, 1.40  # of what sliders make, against the template
LEAST, FEW = 8, 20  # landmarks
SURE = 0.3  # confidence of landmarks that were found automatically
LOST = 0.15  # metres by which the middle one of the landmarks may be off the scan
FAR, NEAR = 0.05, 0.02  # metres: what is farther is no part of the person; what is nearer answers
INWARD = 0.7  # share of matches that face inward, above which a scan is inside out
PARTS = {"head": ("", ("skullbase",)), "left hand": ("l_", ("carpal", "carpo")), "right hand": ("r_", ("carpal", "carpo")),
         "left foot": ("l_", ("tars", "talocrural")), "right foot": ("r_", ("tars", "talocrural"))}  # fmt: skip
SAMPLES = 2500
AGE, YOUNG = 42.0, 18.0  # where searches start: at 25 years the sliders turn from growing up to growing old
FIRM = (2000.0, 60.0)  # how much proportions and details are held back against the sliders of whole people: first, last
ROUNDS = 10
CHOICE = 4  # of these, after which the better one of two searches goes on
STIFF = (300.0, 60.0, 15.0, 4.0, 1.0, 0.25)  # of the surface, round by round
ROUGH = 3  # of these rounds, in which the worst matches count for nothing; later they are what is left to do
HELD = 1.5  # of that, how much hands, ears and lids keep through all rounds
DOUBT = 0.025  # metres by which a landmark misses when it is half believed


@dataclass(frozen=True, eq=False)
class Fit:
    """What a fit found. `humanoid`: at rest; `pose`: one frame on its skeleton that puts it, in metres, where the scan is;
    `bones`: joint parameters from the template's dress pose; `shape`: sliders of the built-in person, None for other
    templates; `displacement` (V,3): from the posed surface's points to the scan, metres in the scan's axes, NaN where
    nothing of the scan answers; `distance` (V,): its length. `report`: figures, see `fit`."""

    humanoid: Humanoid
    pose: Motion
    bones: Bones
    shape: Shape | None
    displacement: Floats
    report: dict[str, Any] = field(default_factory=dict)

    @property
    def distance(self) -> Floats:
        return np.linalg.norm(self.displacement, axis=1)


@one_thread()
def fit(
    mesh: Surface,
    landmarks: Mapping[Any, ArrayLike] | None = None,
    *,
    template: Humanoid | None = None,
    unit: str | None = None,
    name: str = "person",
    loa: int = 4,
    progress: Callable[[int, int], None] | None = None,
    **look: Any,
) -> Fit:
    """An animatable humanoid with the size, pose and shape of a scan, in the standard's rest pose.

    mesh: anything with `vertices` (n,3) and `triangles` (t,3); holes, noise, and what else stands in the scene are borne.
    landmarks: feature point of the standard, or (face, barycentric coordinates) of the template's skin, -> place (3,), in
    the mesh's own unit and axes; at least 8, better 20 to 60; None looks for them on an upright scan. template: a skinned
    humanoid; None is the built-in person, whose sliders are found, too. unit: "mm", "cm", "m", "in", "dm", "ft"; None
    guesses from the person's size. `loa` and `look` as in `vitruvian.person`; without them the person has hair by sex and
    age and a body suit that is painted on, so that the surface seen is the scan's. `progress` is called with stages done
    and in all.

    `report`: "scan_to_fit" and "fit_to_scan" with mean, rms, p95 and max in mm (holes and what is not the person left
    out), "landmarks" name -> mm, "unmatched" share of the skin that no scan answers, "folds", "unit", "joints" name ->
    (3,) in the scan's unit, axes and pose, "seconds" by stage, "warnings".
    Raises VitruvianError for landmarks that are too few, mirrored, unknown or not finite, for a scan without triangles
    and for a unit in which the person would be a giant or a dwarf.
    """
    clock = _Clock(progress)
    warnings: list[str] = []
    vertices = floats(mesh.vertices, "scan: vertices", None, 3)
    triangles = indices(mesh.triangles, "scan: triangles", len(vertices), None, 3)
    if not len(triangles):
        raise VitruvianError("scan: expected a surface, found no triangles")
    marks, sure = _landmarks(landmarks, mesh, warnings)
    base, values = _template(template)
    where = base.landmarks(list(marks))
    places = np.array(list(marks.values()))
    firm = still(list(marks))
    scale, turn, shift, mirrored = bo.similarity((where @ base.points)[firm], places[firm])
    if mirrored:
        raise VitruvianError("landmarks: they are a mirror image of a person; exchange the names with l_ and r_")
    used = _unit(scale, unit, warnings)
    factor = UNITS[used]
    to_scan = np.eye(4)
    to_scan[:3, :3], to_scan[:3, 3] = turn, shift * factor
    upright = lambda p: (p * factor - to_scan[:3, 3]) @ turn  # noqa: E731
    scan, odd = shrink.surface_of(upright(vertices), triangles)
    if odd:
        warnings.append(f"scan: {odd} edges belong to more than two triangles; they are taken as they are")
    goal, size = upright(places), float(np.log(scale * factor))
    clock("similarity")
    found = _by_landmarks(base, where, goal, size)
    _odd_landmarks(found, where, goal, list(marks), scan, warnings)
    scan = _outside_out(found, scan, warnings)
    clock("landmarks")
    args = (scan, where, goal, size, sure)
    tried = [_by_surface(found, values, *args, rounds=range(ROUNDS if values is None else CHOICE))]
    if values is not None:  # people who still grow lie in another valley of the sliders than the grown
        young = Shape(age=YOUNG)
        other, first = replace(found, template=person_template(young)), values_of(young)
        tried.append(_by_surface(other, first, *args, rounds=range(CHOICE)))
        k = int(np.argmin([_missed(one, scan) for one in tried]))
        tried = [_by_surface(tried[k], (values, first)[k], *args, rounds=range(CHOICE, ROUNDS))]
    found = tried[0]
    found = _in_hand(found, *args)
    clock("shape")
    points, folds = _shrunk(found, scan, where, goal, sure)
    clock("offsets")
    made = (found.template, found.bones, points, to_scan)
    if values is None:
        assert template is not None
        humanoid, pose = rested_body(template, *made, name=name)
    else:
        values = found.values
        look = {"outfit": None, "hair": "short" if values[0] > 0.3 else None} | look  # a scan's sex is seldom sure
        humanoid, pose = rested_person(*made, values, name=name, loa=loa, look=look)
    clock("rest")
    matrices = joint_matrices(pose.skeleton, pose)[0]
    with catch_warnings():
        simplefilter("ignore")
        worn = deformer("log", pack(humanoid), weights="normalise")(matrices)[: len(points)].astype(np.float64)
    if loa == 4 or template is not None:  # what the humanoid shows, with what keeps it from running through itself
        points = (worn - to_scan[:3, 3]) @ turn
    report, gap = _report(found.template, scan, points, warnings)
    residual = np.linalg.norm(where @ points - goal, axis=1) * 1000
    centers = np.einsum("jab,jb->ja", matrices[:, :3, :3], pose.skeleton.centers) + matrices[:, :3, 3]
    report |= {
        "landmarks": {str(n): float(r) for n, r in zip(marks, residual, strict=True)},
        "folds": folds,
        "unit": used,
        "joints": {n: (p / factor).tolist() for n, p in zip(pose.skeleton.names, centers, strict=True)},
        "seconds": clock.stages,
        "warnings": warnings,
    }
    for text in warnings:
        warn(text)
    return Fit(humanoid, pose, found.bones, None if values is None else shape_of(values), gap @ turn.T, report)


class _Clock:
    """Seconds per stage."""

    def __init__(self, progress: Callable[[int, int], None] | None):
        self.stages: dict[str, float] = {}
        self.last = time.perf_counter()
        self.progress = progress

    def __call__(self, stage: str) -> None:
        now = time.perf_counter()
        self.stages[stage] = now - self.last
        self.last = now
        if self.progress is not None:
            self.progress(len(self.stages), 5)


def _landmarks(
    landmarks: Mapping[Any, ArrayLike] | None, mesh: Surface, warnings: list[str]
) -> tuple[dict[Any, Floats], Floats | None]:
    """Name or (face, barycentric) -> place, checked; found on the scan when none are given, then with confidences (n,)."""
    given: Mapping[Any, ArrayLike]
    sure = None
    if landmarks is None:
        with catch_warnings(record=True) as said:
            simplefilter("always")
            found = {n: both for n, both in detect(mesh).items() if both[1] >= SURE}
        warnings += [str(w.message) for w in said]
        warnings.append(
            f"landmarks: none were given; {len(found)} feature points were found on the scan, look at the result"
        )
        given = {n: place for n, (place, _) in found.items()}
        sure = np.array([confidence for _, confidence in found.values()])
    else:
        given = landmarks
    out: dict[Any, Floats] = {}
    for name, place in given.items():
        title = name
        if isinstance(name, str):
            title = feature_name(name) or name
        elif not (isinstance(name, tuple) and len(name) == 2 and np.shape(name[1]) == (3,)):
            raise VitruvianError(f"landmark {name!r}: expected a name or (face, three barycentric coordinates)")
        out[title] = floats(place, f"landmark {name!r}", 3)
    if len(out) < LEAST:
        raise VitruvianError(f"landmarks: expected at least {LEAST}, better {FEW} or more, found {len(out)}")
    spread = np.linalg.svd(np.array(list(out.values())) - np.mean(list(out.values()), axis=0), compute_uv=False)
    if spread[1] < 0.02 * spread[0]:
        raise VitruvianError("landmarks: expected points all over the body, found them on one line or at one place")
    return out, sure


def _template(humanoid: Humanoid | None) -> tuple[Template, Floats | None]:
    if humanoid is None:
        shape = Shape(age=AGE)
        return person_template(shape), values_of(shape)
    return body_template(pack(humanoid)), None


def _unit(scale: float, unit: str | None, warnings: list[str]) -> str:
    """The scan's unit: as told, when that makes a person, else the one that does best."""
    best = min(UNITS, key=lambda u: abs(np.log(scale * UNITS[u])))
    if unit is not None:
        if unit not in UNITS:
            raise VitruvianError(f"unit: expected one of {', '.join(UNITS)}, found {unit!r}")
        size = scale * UNITS[unit]
        if not SIZES[0] <= size <= SIZES[1]:
            text = (
                f"unit: in {unit} the person would be {size:.3g} times as tall as the template; is the scan in {best}?"
            )
            raise VitruvianError(text)
        return unit
    size = scale * UNITS[best]
    if not SIZES[0] <= size <= SIZES[1]:
        raise VitruvianError(f"unit: in no unit is the scan a person; in {best} it is {size:.3g} times the template")
    if best != "m":
        warnings.append(f"scan: taken to be in {best}; say the unit to be sure")
    return best


def _odd_landmarks(
    found: Likeness, where: Any, goal: Floats, names: list[Any], scan: shrink.Scan, warnings: list[str]
) -> None:
    """Warn of landmarks that are not on the scan, and of those that do not agree with the others; refuse lost ones."""
    off = shrink.closest(goal, scan)[0]
    if np.median(off) > LOST:
        raise VitruvianError(
            f"landmarks: half of them are more than {np.median(off) * 1000:.0f} mm away from the scan; give them in the "
            "scan's own unit and axes"
        )
    for k in np.flatnonzero(off > FAR)[:5]:
        warnings.append(f"landmark {names[k]}: {off[k] * 1000:.0f} mm away from the scan")
    missed = np.linalg.norm(where @ on_scan(found) - goal, axis=1)
    limit = max(0.06, 5 * float(np.median(missed)))
    for k in np.flatnonzero(missed > limit)[:5]:
        warnings.append(f"landmark {names[k]}: {missed[k] * 1000:.0f} mm from where the others expect it")


def _outside_out(found: Likeness, scan: shrink.Scan, warnings: list[str]) -> shrink.Scan:
    """The scan with normals that point outward."""
    points = on_scan(found)
    normals = shrink.vertex_normals(points, found.template.triangles)
    away, _, face, share = shrink.closest(points, scan)
    theirs = np.einsum("nk,nka->na", share, scan.normals[scan.triangles[face]])
    near = (away < 0.05) & found.template.heard
    if near.any() and ((theirs * normals).sum(axis=1)[near] < 0).mean() > INWARD:
        warnings.append("scan: its surface is inside out; it was turned")
        return scan.turned()
    return scan


def _report(t: Template, scan: shrink.Scan, points: Floats, warnings: list[str]) -> tuple[dict[str, Any], Floats]:
    """Distances both ways, and (V,3) from the points of the skin to the scan, NaN where it has a hole."""
    skin = shrink.surface(points, t.triangles)
    match = shrink.matches(points, skin.normals, scan, distance=NEAR, angle=np.radians(75), worst=0.0)
    answered = match.good & t.heard
    gap = np.where(answered[:, None], match.goal - points, np.nan)
    back = shrink.closest(scan.vertices, skin)[0]
    area = shrink.areas(scan.vertices, scan.triangles)
    mine = back < FAR
    strange = float(area[~mine].sum() / area.sum())
    if strange > 0.02:
        warnings.append(f"scan: {strange:.0%} of its surface is not part of the person and was left out")
    own = shrink.areas(points, t.triangles) * t.heard
    unmatched = float(own[~answered].sum() / own.sum())
    if unmatched > 0.3:
        warnings.append(f"scan: {unmatched:.0%} of the skin has nothing of the scan near it; look at the landmarks")
    missing = []
    for part, (side, words) in PARTS.items():
        held = [n.startswith(side) and any(w in n for w in words) for n in t.names]
        flesh = own * (t.weights @ np.array(held, np.float64) > 0.5)
        if flesh.sum() > 0 and flesh[~answered].sum() > 0.7 * flesh.sum():
            missing.append(part)
    if missing:
        warnings.append(f"scan: nothing of it is the {', '.join(missing)}; there the person is the template's")
    report = {"scan_to_fit": _distances(back[mine]), "fit_to_scan": _distances(match.distance[answered])}
    return report | {"unmatched": unmatched, "strange": strange}, gap


def _distances(metres: Floats) -> dict[str, float]:
    """Mean, rms, 95th percentile and greatest, in mm."""
    mm = metres * 1000 if len(metres) else np.array([np.inf])
    p95 = float(np.quantile(mm, 0.95))
    return {"mean": float(mm.mean()), "rms": float(np.sqrt((mm**2).mean())), "p95": p95, "max": float(mm.max())}


def _by_landmarks(base: Template, where: Any, goal: Floats, size: float) -> Likeness:
    """Joint parameters by landmarks alone, coarse to fine."""
    rows = bo.everywhere(where, base.points, base.weights, goal, np.ones(len(goal)))
    bones = Bones.none(len(base.names))
    usual = np.zeros((len(base.names), bo.EACH))
    usual[:, 6:] = size
    bones = replace(bones, scale=bones.scale + size)
    titles = [n.split()[1] for n in base.knobs.names]
    coarse = ("root", "pelvis", "vl", "vt", "vc", "skull")
    limbs = ("clavicle", "blade", "shoulder", "hip")
    for kept in (
        [t == "root" for t in titles],
        [t in coarse or t[2:] in limbs for t in titles],
        [t in coarse or t[2:] in (*limbs, "elbow", "knee") for t in titles],
        [True] * len(titles),
    ):
        knobs = base.knobs.only(kept)
        bones = bo.settle(
            base.parents, base.centers, base.axes, bones, rows, knobs, usual=usual.ravel(), rounds=10, tolerance=1e-3
        )
    return Likeness(np.zeros(0), bones, base)


def _by_surface(
    found: Likeness,
    values: Floats | None,
    scan: shrink.Scan,
    where: Any,
    goal: Floats,
    size: float,
    sure: Floats | None,
    *,
    rounds: range,
) -> Likeness:
    """Sliders, where the template has some, and joint parameters by landmarks and the surface, after these rounds of all.

    values (K,): what sliders are pulled to, and where they start; None without sliders. sure (n,): confidence of landmarks
    that were found, which the surface replaces little by little; None of given ones.
    """
    base = found.template
    usual = np.zeros((len(base.names), bo.EACH))
    usual[:, 6:] = size
    now, first = found, np.zeros(0)
    if values is not None:
        now, first = (found if rounds.start else replace(found, values=values)), values
        for _ in range(0 if rounds.start else 3):
            rows = bo.everywhere(where, now.template.points, base.weights, goal, _held(sure, len(goal), 0.0))
            now = improved(now, rows, usual=first, firm=FIRM[0], size=beyond(size))
    area = shrink.areas(base.points, base.triangles)
    heard = np.flatnonzero(base.heard & (fingers.depth(base) < fingers.MIXED))
    chance = area[heard] ** 0.6
    density = area[heard] / chance
    density /= np.average(density, weights=chance)
    chance /= chance.sum()
    for round_ in rounds:
        late = round_ / (ROUNDS - 1)
        some = np.random.default_rng(round_).choice(len(heard), min(SAMPLES, len(heard)), replace=False, p=chance)
        distance = np.maximum(0.10 * 0.78**round_ * base.reach, 0.012)
        trust = (0.1 + 0.9 * late) * density[some] ** (1 - late)
        rows = _rows(now, scan, heard[some], distance, np.radians(60 - 20 * late), trust)
        off = np.linalg.norm(where @ on_scan(now) - goal, axis=1)
        held = (1 - 0.7 * late) * _held(sure, len(goal), late) / (1 + (off / DOUBT) ** 2)
        rows = rows.joined(bo.everywhere(where, now.template.points, base.weights, goal, held))
        if values is None:
            t = now.template
            bones = bo.settle(t.parents, t.centers, t.axes, now.bones, rows, t.knobs, rounds=2, usual=usual.ravel())
            now = replace(now, bones=bones)
        else:
            firm = FIRM[0] * (FIRM[1] / FIRM[0]) ** late
            now = improved(now, rows, usual=first, firm=firm, size=beyond(size))
    return now


def _missed(now: Likeness, scan: shrink.Scan) -> float:
    """Metres by which the skin is off the scan, in the mean; what is far counts as little off, it is no part of it."""
    heard = now.template.heard
    points = on_scan(now)
    normals = shrink.vertex_normals(points, now.template.triangles)
    match = shrink.matches(points[heard], normals[heard], scan, distance=FAR, angle=np.radians(70), worst=0.0)
    return float(np.minimum(match.distance[match.good], NEAR).mean()) if match.good.any() else np.inf


def _in_hand(now: Likeness, scan: shrink.Scan, where: Any, goal: Floats, size: float, sure: Floats | None) -> Likeness:
    """Palms and fingers on the scan, when all the rest is."""
    usual = np.zeros((len(now.template.names), bo.EACH))
    usual[:, 6:] = beyond(size) if len(now.values) else size
    off = np.linalg.norm(where @ on_scan(now) - goal, axis=1)
    held = _held(sure, len(goal), 0.0) / (1 + (off / DOUBT) ** 2)
    return fingers.settled(now, scan, where, goal, held, usual.ravel(), fading=sure is not None)


def beyond(size: float) -> float:
    """The logarithm of what size, that of a person against the grown template, is left when sliders have done what they
    can: small children are taken for people of ten years who are smaller, giants for the tallest."""
    if size < np.log(SMALLEST):
        return float(size - np.log(OF_TEN))
    return float(max(size - np.log(TALLEST), 0.0))


def _held(sure: Floats | None, count: int, late: float) -> Floats:
    """(count,) how much landmarks hold, `late` 0..1 in the search: found ones as they are sure, and less and less."""
    return np.ones(count) if sure is None else sure**2 * max(1 - 1.25 * late, 0.0) ** 2


def _rows(now: Likeness, scan: shrink.Scan, picked: Any, distance: Floats, angle: float, trust: Floats) -> Rows:
    """Point-to-plane rows of some vertices, and of some points of the scan against the template's surface."""
    t = now.template
    points = on_scan(now)
    normals = shrink.vertex_normals(points, t.triangles)
    match = shrink.matches(points[picked], normals[picked], scan, distance=distance[picked], angle=angle)
    good = np.flatnonzero(match.good)
    weight = trust[good] / (1 + (match.distance[good] / (0.5 * distance[picked[good]])) ** 2)
    return bo.wanted(t.chosen(picked[good]), t.points, t.weights, match.normal[good], match.goal[good], weight)


def _shrunk(found: Likeness, scan: shrink.Scan, where: Any, goal: Floats, sure: Floats | None) -> tuple[Floats, int]:
    """(V,3) the surface drawn onto the scan by free offsets, and how many triangles are folded."""
    t = found.template
    start = points = on_scan(found)
    smooth = shrink.laplacian(points, t.triangles)
    rng = np.random.default_rng(1)
    left = 0
    for round_ in range(len(STIFF)):
        alpha, distance = STIFF[round_], max(0.06 * 0.7**round_, 0.012)
        worst = shrink.WORST if round_ < ROUGH else 0.0
        normals = shrink.vertex_normals(points, t.triangles)
        turned = np.radians(55 - round_ * 2)
        match = shrink.matches(points, normals, scan, distance=distance, angle=turned, worst=worst)
        pull = (match.good & t.heard) * 1.0
        along = ((match.goal - points) * match.normal).sum(axis=1)
        target = points - start + along[:, None] * match.normal
        stiff = alpha + t.stiff * np.maximum(100 - alpha, 0) * HELD
        # the other way: what points of the scan want of the template's surface
        some = rng.choice(len(scan.vertices), min(len(scan.vertices), 15_000), replace=False)
        skin = shrink.surface(points, t.triangles)
        back = shrink.matches(scan.vertices[some], scan.normals[some], skin, distance=distance, angle=0.8, worst=worst)
        good = back.good & t.heard[t.triangles[back.face]].all(axis=1)
        blend = shrink.blend(t.triangles[back.face[good]], back.share[good], len(points))
        ahead = ((scan.vertices[some][good] - back.goal[good]) * back.normal[good]).sum(axis=1)
        wish = shrink.Wish(blend, blend @ (points - start) + ahead[:, None] * back.normal[good], 0.5)
        wishes = [wish]
        if sure is None:  # found landmarks have done what they can
            wishes.append(shrink.Wish(where, goal - where @ start, 10 / 4.5**round_))
        u = shrink.offsets(smooth, pull, target, stiff, wishes)
        points, left = shrink.unfolded(points, start + u - points, t.triangles, smooth)
    points = uncrossed(start, points, t.triangles, np.ones(len(points), bool), own=t.points)
    return points, left
