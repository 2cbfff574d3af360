"""No candy wrapper: a cylinder twisted by 90 degrees keeps its volume with the log and dual-quaternion operators.

The reference cylinder of the tests: radius 1, length 8 along z, 81 rings of 64 points, one joint in the middle.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import vitruvian as vt
from vitruvian.body.types import Body, Skeleton, Skin, Weights
from vitruvian.show.picture import picture

RINGS, POINTS = 81, 64


def cylinder() -> Body:
    z = np.linspace(-4, 4, RINGS)
    angle = np.arange(POINTS) * 2 * np.pi / POINTS
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([np.c_[ring, np.full(POINTS, h)] for h in z] + [[[0, 0, -4], [0, 0, 4]]])
    i, k = np.meshgrid(np.arange(RINGS - 1), np.arange(POINTS), indexing="ij")
    a, b = i * POINTS + k, i * POINTS + (k + 1) % POINTS
    side = np.concatenate(
        [np.stack([a, b, b + POINTS], -1).reshape(-1, 3), np.stack([a, b + POINTS, a + POINTS], -1).reshape(-1, 3)]
    )
    k = np.arange(POINTS)
    low = np.stack([np.full(POINTS, RINGS * POINTS), (k + 1) % POINTS, k], -1)
    high = np.stack(
        [np.full(POINTS, RINGS * POINTS + 1), (RINGS - 1) * POINTS + k, (RINGS - 1) * POINTS + (k + 1) % POINTS], -1
    )
    s = np.clip((points[:, 2] + 1.5) / 3, 0, 1)
    w = s * s * (3 - 2 * s)
    n = len(points)
    weights = Weights.from_pairs(n, np.tile(np.arange(n), 2), np.repeat([0, 1], n), np.concatenate([1 - w, w]))
    skeleton = Skeleton(("fixed", "turning"), np.array([-1, 0]), np.zeros((2, 3)))
    return Body("cylinder", skeleton, Skin(points, np.concatenate([side, low, high]), weights))


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def main(out: Path = Path("out/examples")) -> None:
    out.mkdir(parents=True, exist_ok=True)
    body = cylinder()
    c, s = np.cos(np.pi / 2), np.sin(np.pi / 2)
    matrices = np.tile(np.eye(4), (1, 2, 1, 1))
    matrices[0, 1, :2, :2] = [[c, -s], [s, c]]
    rest = volume(body.skin.rest, body.skin.triangles)
    kept = {}
    for name in ("linear", "dual-quaternion", "log", "log-pair", "hybrid"):
        posed = vt.deformer(name, body)(matrices)[0].astype(float)
        kept[name] = volume(posed, body.skin.triangles) / rest
        print(f"{name:<16} keeps {kept[name]:.4f} of the volume")
        if name in ("linear", "log"):
            upright = posed[:, [0, 2, 1]] * [1, 1, -1] * 0.2
            picture(vt.Mesh(upright, body.skin.triangles), out / f"twist-{name}.png")
    assert kept["log"] >= 0.999 and kept["dual-quaternion"] >= 0.999
    assert abs(kept["linear"] - 0.9032) < 1e-3


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
