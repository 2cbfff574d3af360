"""Tie joints of the built-in body to its skin: `python tools/place_joints.py` writes `joints.npz` of the pack.

The source places a joint by a cube of vertices of its own. On people of average height the cubes of knees and elbows lie
where the skin bends; its targets of height move them along the limb, by up to 70 mm for knees, while the skin stays. Here
these centres become affine combinations of the vertices round the joint: shares follow the product of what moves with the
joint and what does not, corrected as little as possible so that they give the cube's place on people of average height:
women and men of three ages, thin and heavy. The centre of anyone else then goes where the skin goes.

The cubes of fingers lie just under the skin of their backs. The heads of phalanges fill a finger from its back to the
tendons in front: those centres go to `DEPTH` of the way from back to front, and to the middle from side to side; those of
the knuckles, with the palm before them, to `KNUCKLE`.

Left is mastered, right is its mirror image.
"""

from __future__ import annotations

import itertools

import numpy as np

from build_body_pack import write
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.person import weight_matrix
from vitruvian.modeling.shape import Shape, shaped

LIMBS = ("l_knee", "l_elbow")
DEPTH, KNUCKLE = 0.45, 0.34
ROUNDS = 4  # of finding the middle from side to side and from back to front
PRICE = 0.01  # metres that a person's centre may be off, for shares changed by their own size


def below() -> np.ndarray:
    """(13380, 146) how much of each vertex moves with a joint or those below it."""
    out = weight_matrix()[: source.BODY].toarray()
    for i in range(len(anatomy.names()) - 1, 0, -1):
        out[:, anatomy.parents()[i]] += out[:, i]
    return out


def anchors() -> list[np.ndarray]:
    """Points of people of average height."""
    people = itertools.product((0.0, 1.0), (10.0, 25.0, 90.0), (0.0, 1.0))
    return [shaped(Shape(gender=g, age=a, weight=w)) for g, a, w in people]


def cubes(points: np.ndarray) -> dict[str, np.ndarray]:
    """The source's joint centres."""
    return dict(zip(anatomy.names(), source.array("centres").astype(np.float64) @ points[source.POINTS :], strict=True))


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def fingers(points: np.ndarray) -> dict[str, np.ndarray]:
    """Where the joints of the left fingers and thumb belong."""
    from trimesh import Trimesh
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    rays = RayMeshIntersector(
        Trimesh(points[: source.BODY], source.array("triangles"), process=False), scale_to_box=False
    )
    at, out = cubes(points), {}
    tips = anatomy.ends(points)

    def room(center: np.ndarray, way: np.ndarray) -> tuple[float, float]:
        """Metres of flesh on both sides of a centre."""
        hits, ray, _ = rays.intersects_location(np.stack([center] * 2), np.stack([way, -way]), multiple_hits=False)
        far = np.linalg.norm(hits - center, axis=1)
        return float(far[ray == 0].min()), float(far[ray == 1].min())

    wrist = at["l_radiocarpal"]
    back = unit(np.cross(at["l_metacarpophalangeal_2"] - wrist, at["l_metacarpophalangeal_5"] - wrist))
    chains = [[f"l_{k}_{r}" for k in KINDS] for r in (2, 3, 4, 5)] + [["l_metacarpophalangeal_1", THUMB]]
    for chain in chains:
        stops = [at[n] for n in chain] + [tips[chain[-1]]]
        for i, name in enumerate(chain):
            before = stops[i] - stops[i - 1] if i else stops[1] - stops[0]
            along = unit(unit(before) + unit(stops[i + 1] - stops[i]))
            across = unit(np.cross(along, back))
            behind = unit(np.cross(across, along))
            if name.endswith("_1"):  # the back of the thumb looks sideways
                across, behind = behind, across
            near, far = room(stops[i], behind)
            behind = behind if near < far else -behind
            center, knuckle = stops[i].copy(), name.startswith("l_metacarpophalangeal")
            for _ in range(ROUNDS):
                if not knuckle:
                    one, two = room(center, across)
                    center = center + across * (one - two) / 2
                one, two = room(center, behind)
                center = center + behind * (one - (KNUCKLE if knuckle else DEPTH) * (one + two))
            out[name] = center
    return out


KINDS = ("metacarpophalangeal", "carpal_proximal_interphalangeal", "carpal_distal_interphalangeal")
THUMB = "l_carpal_interphalangeal_1"


def tied(share: np.ndarray, people: list[np.ndarray], wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n,) and their shares (n,), of sum one, that put a joint where it is `wanted` (k,3) on people (k)."""
    vertex = np.flatnonzero(share > 0.02)
    share = share[vertex] / share[vertex].sum()
    rows = np.stack([p[vertex] for p in people])
    middle = np.einsum("v,kva->ka", share, rows)
    matrix = (rows - middle[:, None]).transpose(0, 2, 1).reshape(-1, len(vertex)) * np.sqrt(share)
    matrix = np.concatenate([matrix, np.sqrt(share)[None] * 1e3])  # and the sum stays
    missing = np.append((wanted - middle).ravel(), 0.0)
    change = matrix.T @ np.linalg.solve(matrix @ matrix.T + PRICE**2 * np.eye(len(matrix)), missing)
    out = share + np.sqrt(share) * change
    return vertex, out / out.sum()


def main() -> None:
    names, move, people = list(anatomy.names()), below(), anchors()
    aims = [{n: cubes(p)[n] for n in LIMBS} | fingers(p) for p in people]
    joints, vertices, shares = [], [], []
    mirror = source.array("mirror")
    for name in aims[0]:
        inside = np.clip(move[:, names.index(name)], 0, 1)
        wanted = np.stack([a[name] for a in aims])
        vertex, share = tied(inside * (1 - inside), people, wanted)
        found = np.einsum("v,kva->ka", share, np.stack([p[vertex] for p in people]))
        was = np.stack([cubes(p)[name] for p in people])
        off, moved = (1000 * np.linalg.norm(found - x, axis=1) for x in (wanted, was))
        text = f"{off.mean():.1f} ({off.max():.1f}) mm off, {moved.mean():.1f} moved"
        print(f"{name}: {len(vertex)} vertices, {text}")
        for which, some in ((name, vertex), ("r" + name[1:], mirror[vertex])):
            joints.append(np.full(len(some), names.index(which)))
            vertices.append(some)
            shares.append(share)
    arrays = {"joint": np.concatenate(joints).astype(np.int16), "vertex": np.concatenate(vertices).astype(np.int32)}
    write(source.PACK / "joints.npz", arrays | {"share": np.concatenate(shares).astype(np.float32)})


if __name__ == "__main__":
    main()
