"""The space of shapes that several people of one topology span, with sizing parameters.

From measures to weights of the people: principal components of the examples (95 % of the variance), joint parameters and
displacements apart, regressed on the measures; what the components leave out comes back near each example by Gaussians,
so that at an example's own measures the example itself comes out. Then weights change as little as it takes to measure
exactly as asked.

Source: seed 003, table 1, "Shape Interpolator" (Modeling Synthesizer, Modifier Synthesizer); the engine is ours, after
H. Seo, N. Magnenat-Thalmann, An automatic modeling of human bodies from sizing parameters (2003).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.distance import cdist

from vitruvian.body.types import Floats, require
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling.blend import BEYOND, alike, held_by, measures_of, mixed, owned, parts_of

KEPT = 0.95  # of the variance, by principal components
FEW = 10  # examples: below this their coefficients are a linear function of the measures
RIDGE = 1e-6  # of standardised measures
CLOSE, MET = 0.002, 3e-4  # metres: what a measure may be off without a word; at which the search stops
ROUNDS = 12  # bodies tried


@dataclass(frozen=True, eq=False)
class Space:
    """The shapes that several people of one topology span, with the measures that size them (m), by name."""

    people: tuple[Humanoid, ...]
    names: tuple[str, ...]
    sizes: Floats  # (n, names)

    @cached_property
    def _parts(self) -> tuple[Floats, Floats]:
        """Joint centres (n,3J), and displacements of the first shape's points from what the centres carry (n,3V)."""
        centers, moves = [], []
        for p in self.people:
            joints = p.joints()
            c = np.array([j.center for j in joints])
            d = p.skin_coord - held_by(joints, len(p.skin_coord)) @ c
            centers.append(c.ravel())
            moves.append(d[parts_of(p)[0]].ravel())
        return np.array(centers), np.array(moves)

    @cached_property
    def _scale(self) -> tuple[Floats, Floats]:
        spread = self.sizes.std(axis=0)
        return self.sizes.mean(axis=0), np.where(spread > 1e-9, spread, 1.0)

    @cached_property
    def _models(self) -> tuple[_Model, _Model]:
        mean, spread = self._scale
        z = (self.sizes - mean) / spread
        joints, moves = self._parts
        return _Model.of(z, joints), _Model.of(z, moves)

    def weights(self, sizes: Floats) -> tuple[Floats, Floats]:
        """(n,) weights of the joint parameters and of the displacements of every example, at measures (names,)."""
        mean, spread = self._scale
        z = (np.asarray(sizes, np.float64) - mean) / spread
        joints, moves = self._models
        return joints.weights(z), moves.weights(z)

    def made(self, wishes: Mapping[str, float], *, progress: Callable[[int, int], None] | None = None) -> Humanoid:
        """A new body of these measures (m): the Modeling Synthesizer. All of `names` must be given.

        Weights of the people stay within -0.5..1.5. Warns of sizes beyond those of the people, and of what stays more
        than 2 mm off, with the nearest that they reach. `progress` is called with bodies tried and the most there may be.
        """
        wrong = [n for n in self.names if n not in wishes] + [n for n in wishes if n not in self.names]
        require(not wrong, "measures", f"all of {', '.join(self.names)} and no other", ", ".join(wrong))
        asked = np.array([float(wishes[n]) for n in self.names])
        require(bool(np.isfinite(asked).all()), "measures", "finite sizes in metres", asked.tolist())
        joints, skins = self.weights(self._within(asked, self.sizes))

        def at(change: Floats, bare: bool) -> Humanoid:
            return mixed(self.people, joints + change, skins + change, bare=bare)

        return self._met(asked, at, skins, progress)

    def changed(
        self, humanoid: Humanoid, deltas: Mapping[str, float], *, progress: Callable[[int, int], None] | None = None
    ) -> Humanoid:
        """A body changed by measures (m) that keeps what makes it itself: the Modifier Synthesizer. Warns as `made`."""
        unknown = set(deltas) - set(self.names)
        require(not unknown, "measures", f"some of {', '.join(self.names)}", ", ".join(sorted(unknown)))
        moves = np.array([float(deltas.get(n, 0.0)) for n in self.names])
        require(bool(np.isfinite(moves).all()), "measures", "finite changes in metres", moves.tolist())
        alike(self.people[0], humanoid)
        now = _sizes(humanoid, self.names)
        if not moves.any():
            return owned(humanoid)
        before, after = self.weights(now), self.weights(self._within(now + moves, np.vstack([self.sizes, now])))
        joints, skins = (b - a for a, b in zip(before, after, strict=True))
        family = [humanoid, *self.people]

        def at(change: Floats, bare: bool) -> Humanoid:
            own = [np.concatenate([[1.0], w + change]) for w in (joints, skins)]
            return mixed(family, *own, lead=0, bare=bare)

        return self._met(now + moves, at, skins, progress)

    def _within(self, asked: Floats, known: Floats) -> Floats:
        """The sizes (names,) within those known (n, names) and half their range more, with a warning of what is beyond."""
        low, high = known.min(axis=0), known.max(axis=0)
        for name, want, least, most in zip(self.names, asked, low, high, strict=True):
            if not least - CLOSE <= want <= most + CLOSE:
                warn(f"measure {name}: {want:.3f} m is beyond these people, who have {least:.3f} to {most:.3f}")
        return np.clip(asked, low - BEYOND * (high - low), high + BEYOND * (high - low))

    def _met(
        self,
        asked: Floats,
        make: Callable[[Floats, bool], Humanoid],
        start: Floats,
        progress: Callable[[int, int], None] | None,
    ) -> Humanoid:
        """The body that measures as asked: weights (n,) of all people changed as little as that takes, from `start`.

        Gauss-Newton steps within bounds; measures of a mixture are nearly the mixture of measures, so that those of the
        people are the first slopes; Broyden's updates mend them.
        """
        from scipy.optimize import lsq_linear

        n = len(start)
        slopes = self.sizes.T.copy()
        change, step = np.zeros(n), np.zeros(n)
        best, least, missing = change, np.inf, asked
        for k in range(ROUNDS):
            if progress is not None:
                progress(k, ROUNDS)
            left = asked - _sizes(make(change + step, True), self.names)
            if step.any():
                slopes += np.outer(missing - left - slopes @ step, step) / (step @ step)
            if np.linalg.norm(left) < least:
                change = change + step
                best, least, missing = change, float(np.linalg.norm(left)), left
                shrink = 1.0
            else:
                shrink *= 0.5
            if (np.abs(missing) < MET).all():
                break
            now = start + change
            low, high = np.minimum(now, -BEYOND) - 1e-9, np.maximum(now, 1 + BEYOND) + 1e-9
            rows = np.concatenate([slopes, np.full((1, n), 100.0), 1e-3 * np.eye(n)])
            wanted = np.concatenate([missing, np.zeros(n + 1)])
            step = shrink * lsq_linear(rows, wanted, bounds=(low - now, high - now)).x
            step -= step.mean()
        for name, miss, want in zip(self.names, missing, asked, strict=True):
            if abs(miss) > CLOSE:
                warn(f"measure {name}: the nearest that these people reach is {want - miss:.3f} m, not {want:.3f}")
        return make(best, False)


def _sizes(humanoid: Humanoid, names: Sequence[str]) -> Floats:
    found = measures_of(humanoid, names)
    lost = [n for n in names if n not in found]
    require(
        not lost, f"{humanoid.name}: measures", "feature points (Sites) for " + ", ".join(names), f"none for {lost}"
    )
    return np.array([found[n] for n in names])


def space(people: Sequence[Humanoid], names: Sequence[str]) -> Space:
    """The space of these people sized by these measures (names of `vitruvian.modeling.measures`).

    Raises VitruvianError for fewer than two people, people of different topology, unknown measures, and measures that
    two of the people share, for then they do not tell them apart.
    """
    from vitruvian.modeling.measures import NAMES

    require(len(people) > 1, "people", "two or more", len(people))
    require(len(names) > 0, "measures", "one or more", 0)
    for name in names:
        require(name in NAMES, "measure", f"one of {', '.join(NAMES)}", repr(name))
    for other in people[1:]:
        alike(people[0], other)
    found = Space(tuple(people), tuple(names), np.array([_sizes(p, names) for p in people]))
    assert found._models  # people that measures do not tell apart are refused here
    return found


@dataclass(frozen=True, eq=False)
class _Model:
    """From standardised measures to weights of the examples, which sum to 1."""

    examples: Floats  # (n, m)
    reach: float  # of the Gaussians that make examples exact
    wide: float  # of those that carry coefficients; 0: linear regression
    smooth: Floats  # (features, n): weights of the examples less 1/n, for each feature
    rest: Floats  # (n, n): what is missing at the examples

    @staticmethod
    def of(z: Floats, data: Floats) -> _Model:
        n = len(z)
        data = data - data.mean(axis=0)
        values, vectors = np.linalg.eigh(data @ data.T)
        order = np.argsort(values)[::-1]
        values, vectors = np.maximum(values[order], 0), vectors[:, order]
        share = np.cumsum(values) / max(values.sum(), 1e-30)
        u = vectors[:, : int(np.searchsorted(share, KEPT)) + 1]
        u = u - u.mean(axis=0)
        apart = cdist(z, z)
        upper = apart[np.triu_indices(n, 1)]
        if (upper < 1e-6).any():
            raise VitruvianError("people: two have the same measures; leave one out or give another measure")
        wide = 0.0 if n < FEW else float(np.median(upper))
        np.fill_diagonal(apart, np.inf)
        reach = 0.5 * float(np.median(apart.min(axis=1)))  # of its own: an example's bump ends before the next one
        f = _features(z, z, wide)
        penalty = np.full(f.shape[1], RIDGE)
        penalty[0] = 0.0
        # scores of the components are u s; a body's weights from them are 1/n + u (u^T ...): s drops out
        smooth = np.linalg.solve(f.T @ f + np.diag(penalty) + 1e-12 * np.eye(f.shape[1]), f.T @ (u @ u.T))
        here = 1 / n + f @ smooth
        near = _gauss(z, z, reach)
        return _Model(
            z,
            reach,
            wide,
            np.asarray(smooth, np.float64),
            np.asarray(np.linalg.solve(near, np.eye(n) - here), np.float64),
        )

    def weights(self, z: Floats) -> Floats:
        here = z[None]
        smooth = 1 / len(self.examples) + _features(here, self.examples, self.wide) @ self.smooth
        return (smooth + _gauss(here, self.examples, self.reach) @ self.rest)[0]


def _gauss(at: Floats, examples: Floats, reach: float) -> Floats:
    return np.exp(-0.5 * (cdist(at, examples) / reach) ** 2)


def _features(at: Floats, examples: Floats, wide: float) -> Floats:
    linear = np.hstack([np.ones((len(at), 1)), at])
    return np.hstack([linear, _gauss(at, examples, wide)]) if wide else linear
