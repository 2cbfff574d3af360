"""The compiled kernels. Arrays are C-contiguous and belong to the caller; see src/native and vitruvian.deform.bind."""

import numpy as np
from numpy.typing import NDArray

Single = NDArray[np.float32]
Double = NDArray[np.float64]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]

def instruction_set() -> str:
    """ "base" or "v3": which build of the kernels is in use."""

def use_instruction_set(name: str) -> None:
    """Chooses a build; ValueError where the processor or the build has no such one."""

def parse_floats(text: bytes | bytearray | memoryview, expected: int = -1) -> Double: ...
def forward_kinematics(
    parent: Ints,
    center: Double,
    rotation: Double,
    translation: Double,
    root: Double | None,
    stretch: Double | None,
    binding: Double | None,
    out: Double,
    threads: int = 0,
) -> None: ...
def linear_table(matrices: Double, still: bool = False) -> Single:
    """(F,J,4,4) to (F,J,16): M - I by columns of four; with `still` one more, which does not move."""

class Buckets:
    """What `vitruvian.deform.bind.Laid` binds to the kernels."""

    def add(
        self,
        influences: int,
        lanes: int,
        count: int,
        rest: Single,
        joint: Ints,
        weight: Single,
        row: Ints | None,
        target: Ints | None,
        shared: bool,
        base: Ints | None = None,
        set: Ints | None = None,
        center: Single | None = None,
        carry: Single | None = None,
    ) -> None: ...

def linear(buckets: Buckets, table: Single, out: Single, threads: int = 0) -> None: ...
def touch(
    table: Single | None,
    rest: Single,
    joint: Ints,
    weight: Single,
    target: Ints | None,
    count: int,
    out: Single,
    threads: int = 0,
) -> None:
    """The loads and stores of `linear` in lanes with four influences, for benchmarks."""

def deviation(matrices: Double) -> float:
    """How far the 3x3 parts of (F,J,4,4) are from rotations; 2 or more where one mirrors."""

def dual_table(
    matrices: Double, tree: Ints, left: Ints, follow: bool, memory: Double | None = None
) -> tuple[Single, Bytes]:
    """Rigid (F,J,4,4) to dual quaternions (F,J+1,8) with agreeing signs, and (F,) whether all pairs agree."""

def twist_table(
    matrices: Double, tree: Ints, left: Ints, follow: bool, memory: Double | None, pairs: Ints
) -> tuple[Single, Single]:
    """Half twists (F,P,8) of pairs (P,2), and dual quaternions (F,J+1,8)."""

def turn_shares(
    matrices: Double,
    tree: Ints,
    left: Ints,
    follow: bool,
    memory: Double | None,
    pairs: Ints,
    low: Double,
    high: Double,
    hard: bool,
    row: Ints,
    member: Ints,
) -> Single:
    """(F,S): from 0 to 1 as the largest angle of a set's pairs goes from low to high (P,)."""

def rigid(
    buckets: Buckets,
    table: Single,
    steps: int,
    agree: Bytes | None,
    bases: Single | None,
    out: Single,
    threads: int = 0,
    linear: Single | None = None,
    share: Single | None = None,
) -> None: ...
def normals(
    points: Single,
    triangles: Ints,
    row: Ints,
    face: Ints,
    point: Ints,
    order: Ints,
    out: Single,
    threads: int = 0,
) -> None: ...

class Contours: ...
class Hand: ...

def bind_contours(*arrays: Double | Ints) -> Contours:
    """In the order of src/native/kernels.h, ContourProgram."""

def contour_motions(program: Contours, matrices: Double, follow: bool, with_joints: bool = True) -> Double:
    """Joint matrices (F,J,4,4), unless left out, followed by the motions of contours: (F,J+C,4,4) or (F,C,4,4)."""

def bind_hand(*arrays: Double | Single | Ints) -> Hand:
    """In the order of src/native/kernels.h, HandJob."""

def hand(program: Hand, matrices: Double, out: Single) -> None:
    """Moves a hand's points in out (F,V,3)."""

def cloth_frame(x: Single, v: Single, d: Single, *arrays: object) -> None:
    """One frame of cloth, in place; in the order of `vitruvian.cloth.solver.step`."""

def near_plan(x: Single, triangles: Ints, edges: Ints, sides: Ints) -> tuple[Ints, ...]:
    """By what `near_cloth` works; it finds the same by any, the faster the nearer cloth still is to what it was near to."""

def near_cloth(
    x: Single,
    v: Single,
    triangles: Ints,
    edges: Ints,
    sides: Ints,
    same: Ints,
    limits: Single,
    before: Ints,
    side: Single,
    plan: tuple[Ints, ...],
    threads: int = 0,
) -> tuple[Ints, Single, Ints, Single]:
    """Pairs (k,4), sides (c,) of the first, vertices with triangles, and keys (r,2) and sides of those to remember."""

def cloth_cuts(x: Single, triangles: Ints, edges: Ints, same: Ints) -> Ints:
    """(k,2) edges and triangles without a common vertex that cut each other."""

def cloth_clear(x: Single, vertex: Ints, nearest: Ints, *arrays: object) -> None:
    """Puts cloth out of a body, in place; see `vitruvian.cloth.layers_numpy.cloth_clear`."""

def cloth_feet(
    point: Single, normal: Single, corner: Ints, share: Single, offset: Single, foot: Single, up: Single, out: Single
) -> None:
    """Feet of cloth on a surface, their normals and the cloth; see `vitruvian.cloth.layers_numpy.cloth_feet`."""

def cloth_limbs(r: Single, v: Single, *arrays: object) -> None:
    """One frame of cloth about limbs, in place; in the order of `vitruvian.cloth.layers_numpy.cloth_limbs`."""

def cloth_pinch(
    x: Single, part: Single, foot: Single, up: Single, vertex: Ints, nearest: Ints, *arrays: object
) -> None:
    """Draws cloth towards its feet, in place; see `vitruvian.cloth.layers_numpy.cloth_pinch`."""
