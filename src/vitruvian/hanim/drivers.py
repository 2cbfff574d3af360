"""Displacers whose weight follows a joint's angle, kept in files as a MetadataSet of the Displacer.

The standard leaves weights to the host (ISO/IEC 19774-1, Displacer); browsers that do not know the set show the
Displacer's own weight. In X3D:

    <HAnimDisplacer name='l_elbow_bend_action' ...>
      <MetadataSet name='driver' reference='vitruvian'>
        <MetadataString name='joint' value='"l_elbow"'/>  <MetadataFloat name='axis' value='1 0 0'/>
        <MetadataFloat name='angles' value='-1.57 0'/>    <MetadataFloat name='weights' value='1 0'/>
      </MetadataSet>
    </HAnimDisplacer>
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import VitruvianError
from vitruvian.hanim.graph import Node
from vitruvian.hanim.humanoid import Displacer
from vitruvian.hanim.values import value

SET, MAKER = "driver", "vitruvian"
MOST = 1000  # points of a curve


@dataclass(frozen=True, eq=False)
class Driver:
    """Weight of a displacer by the angle of a joint.

    The angle is that of the part of the joint's rotation which is about `axis` (3,), a unit vector in the joint's frame,
    radians. The weight is interpolated between `angles` (n,), rising, and `weights` (n,), and stays beyond the ends.
    Raises VitruvianError naming the array for values that do not fit.
    """

    joint: str
    axis: NDArray[np.float64]
    angles: NDArray[np.float64]
    weights: NDArray[np.float64]

    def __post_init__(self) -> None:
        axis, angles, weights = (np.array(a, np.float64).reshape(-1) for a in (self.axis, self.angles, self.weights))
        size = float(np.linalg.norm(axis)) if axis.shape == (3,) and np.isfinite(axis).all() else 0.0
        problem = ""
        if not self.joint:
            problem = "joint: expected a name, found none"
        elif not size > 1e-9:
            problem = f"axis: expected three numbers, not all zero, found {axis[:4].tolist()}"
        elif not 1 <= len(angles) <= MOST or len(weights) != len(angles):
            problem = f"angles, weights: expected 1 to {MOST} of each, found {len(angles)} and {len(weights)}"
        elif not (np.isfinite(angles).all() and np.isfinite(weights).all() and (np.diff(angles) > 0).all()):
            problem = "angles, weights: expected finite numbers, angles rising, found others"
        if problem:
            raise VitruvianError(f"driver {problem}")
        for name, array in (("axis", axis / size), ("angles", angles), ("weights", weights)):
            object.__setattr__(self, name, array)


def driver_of(displacer: Displacer) -> Driver | None:
    """The driver in a displacer's metadata; None when there is none.

    Raises VitruvianError naming the displacer for one that does not make sense.
    """
    node = displacer.metadata
    if node is None or node.type != "MetadataSet" or value(node, "name", "SFString", "") != SET:
        return None
    found: dict[str, object] = {"joint": "", "axis": [], "angles": [], "weights": []}
    for child in node.children("value"):
        name = str(value(child, "name", "SFString", ""))
        if name not in found:
            continue
        kind = "MFString" if name == "joint" else "MFDouble"
        got = value(child, "value", kind, None)
        if got is None:
            continue
        found[name] = str(next(iter(got), "")) if name == "joint" else got  # type: ignore[call-overload]
    try:
        return Driver(**found)  # type: ignore[arg-type]
    except VitruvianError as error:
        raise VitruvianError(f"displacer {displacer.name}: {error}") from None


def drive(displacer: Displacer, driver: Driver | None) -> None:
    """Put a driver into a displacer's metadata, in place of what is there; None takes it out."""
    if driver is None:
        displacer.metadata = None
        return
    fields = {"axis": driver.axis, "angles": driver.angles, "weights": driver.weights}
    children = [_entry("MetadataString", "joint", [driver.joint])]
    children += [_entry("MetadataDouble", name, array.copy()) for name, array in fields.items()]
    displacer.metadata = Node(
        "MetadataSet", fields={"name": SET, "reference": MAKER, "value": children}, container="metadata"
    )


def _entry(kind: str, name: str, content: object) -> Node:
    return Node(kind, fields={"name": name, "value": content}, container="value")
