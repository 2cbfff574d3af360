"""A part of another figure brought to where it grows on a body, whose joints it takes over. See `modeling.parts`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Humanoid, Joint, Site

_SAME = 1e-9  # metres
_APART = 1e-4  # metres: edges that are no farther apart, in the median, stay as they are
WIDE, FADE = 2.0, 0.7  # in radii of an open edge: what lies round it, and from how far on a part keeps its shape
NEARLY = 0.95  # of the way to a cut: two points of an edge never come to one place
SOME = 6  # points of an edge that say how those near it move


def find(humanoid: Humanoid, name: str) -> Joint | None:
    """The joint of that name, or the one that the standard calls the same."""
    known = tables.canonical(name) or name
    return next((j for j in humanoid.joints() if j.name == name or tables.canonical(j.name) == known), None)


def brought(figure: Humanoid, body: Humanoid, root: str) -> Humanoid:
    """The figure moved as a whole (metres) so that its joint `root` is at that of the body; itself where one has none."""
    mine, theirs = find(body, root), find(figure, root)
    if mine is None or theirs is None:
        return figure
    step = mine.center - theirs.center
    if np.linalg.norm(step) < _SAME:
        return figure
    out = figure.copied()
    out.skin_coord = figure.skin_coord + step
    for joint in {id(j): j for j in out.joints()}.values():
        joint.center = joint.center + step
        joint.sites = [_moved(s, step) for s in joint.sites]
        for segment in joint.segments:
            segment.sites = [_moved(s, step) for s in segment.sites]
    return out


def met(points: Floats, rim: NDArray[np.int64], cut: Floats) -> Floats:
    """(n,3) a part's points, its open edge drawn onto the body's cut; what is farther from the edge keeps its shape.

    `rim` (e,2): the edge's points; `cut` (m,2,3): edges of the body's cuts, of which those round the rim count. Metres.
    """
    from scipy.spatial import cKDTree

    if not len(rim):
        return points
    edge = np.unique(rim)
    middle = points[edge].mean(axis=0)
    own = points[edge] - middle
    size = float(np.linalg.norm(own, axis=1).mean())
    beside = cut[np.linalg.norm(cut.mean(axis=1) - middle, axis=1) < WIDE * size]
    if not len(beside) or size <= 0:
        return points
    if np.median(np.linalg.norm(_closest(points[edge], beside) - points[edge], axis=1)) < _APART:
        return points  # a coarser one of the same figure: it fits
    center = beside.reshape(-1, 3).mean(axis=0)
    grow = float(np.linalg.norm(beside.reshape(-1, 3) - center, axis=1).mean()) / size
    goal = center + grow * own
    goal += NEARLY * (_closest(goal, beside) - goal)
    step = goal - points[edge]
    away, near = cKDTree(points[edge]).query(points, k=min(SOME, len(edge)))
    away, near = away.reshape(len(points), -1), near.reshape(len(points), -1)
    share = np.clip(1 - away[:, 0] / (FADE * size), 0, 1)
    share = share**2 * (3 - 2 * share)
    weight = 1 / (away + 1e-9) ** 2
    mean = np.einsum("nk,nka->na", weight / weight.sum(axis=1, keepdims=True), step[near])
    return points + share[:, None] * mean


def _closest(points: Floats, edges: Floats) -> Floats:
    """(n,3) the nearest of edges (m,2,3) to points (n,3)."""
    a, way = edges[:, 0], edges[:, 1] - edges[:, 0]
    along = np.einsum("nma,ma->nm", points[:, None] - a, way) / np.maximum((way * way).sum(axis=1), 1e-18)
    places = a + np.clip(along, 0, 1)[..., None] * way
    best = np.linalg.norm(places - points[:, None], axis=2).argmin(axis=1)
    return np.asarray(places[np.arange(len(points)), best], np.float64)


def taken_over(body: Humanoid, figure: Humanoid, root: str) -> None:
    """Give the body's joints from `root` on the centres of the figure's of the same names, and their Sites the places."""
    top = find(body, root)
    if top is None:
        return
    theirs = {tables.canonical(j.name) or j.name: j for j in figure.joints()}
    places = {s.name: s for s in figure.all_sites()}
    for joint in top.walk():
        other = theirs.get(tables.canonical(joint.name) or joint.name)
        if other is None:
            continue
        joint.center = other.center
        joint.sites = [_placed(s, places) for s in joint.sites]
        for segment in joint.segments:
            segment.sites = [_placed(s, places) for s in segment.sites]


def _moved(site: Site, step: Floats) -> Site:
    return replace(site, translation=site.translation + step, node=None)


def _placed(site: Site, places: dict[str, Site]) -> Site:
    other = places.get(site.name)
    if other is None or np.array_equal(other.center + other.translation, site.center + site.translation):
        return site
    return replace(site, translation=other.center + other.translation - site.center, node=None)
