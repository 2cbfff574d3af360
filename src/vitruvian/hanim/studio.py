"""Backdrop, lights and cameras of a new scene: the whole figure in frame from a little below eye height."""

from __future__ import annotations

import numpy as np

from vitruvian.errors import FileError
from vitruvian.hanim.graph import Node
from vitruvian.hanim.humanoid import Array, Humanoid, Shape
from vitruvian.hanim.reading import Reading

_FIELD_OF_VIEW = 0.6  # radians, of the shorter side of the window
_LIGHTS = (  # direction, intensity, colour
    ((-0.5, -0.6, -0.7), 0.9, (1.0, 0.97, 0.92)),
    ((0.8, -0.2, -0.5), 0.4, (0.85, 0.92, 1.0)),
    ((0.1, -0.5, 0.9), 0.5, (1.0, 1.0, 1.0)),
)
_CAMERAS = {"Front": 0.0, "Three-quarter": 0.6, "Side": np.pi / 2, "Back": np.pi}  # turned about Y


def bounds(humanoids: list[Humanoid]) -> tuple[Array, Array]:
    """Box around all figures at rest, with the Humanoids' own scale and translation (not their rotation)."""
    points: list[Array] = []
    for h in humanoids:
        own = [np.array([j.center for j in h.joints()]).reshape(-1, 3), h.skin_coord]
        shapes: list[Shape] = [s for g in h.segments() for s in g.shapes]
        for s in shapes:
            if s.points is not None and len(s.points):
                m = s.transform
                own.append(s.points if m is None else s.points @ m[:3, :3].T + m[:3, 3])
        points.append(np.concatenate(own) * h.scale + h.translation)
    everything = np.concatenate(points)
    if not len(everything):
        return np.array([-0.5, 0.0, -0.3]), np.array([0.5, 1.75, 0.3])
    return everything.min(axis=0), everything.max(axis=0)


def studio(humanoids: list[Humanoid]) -> list[Node]:
    """Backdrop, lights and cameras that show the whole figure from a little below eye height."""
    low, high = bounds(humanoids)
    size = np.maximum(high - low, 1e-3)
    middle = (low + high) / 2
    tall = float(max(size[1], size[0]))
    back = 0.58 * tall / np.tan(_FIELD_OF_VIEW / 2) + size[2] / 2
    eye = low[1] + 0.78 * size[1]
    nodes = [
        Node("NavigationInfo", fields={"type": ["EXAMINE", "ANY"], "headlight": False, "speed": tall}),
        Node(
            "Background",
            fields={
                "skyColor": np.array([[0.62, 0.68, 0.76], [0.86, 0.89, 0.92], [0.93, 0.94, 0.95]]),
                "skyAngle": np.array([1.05, 1.57]),
                "groundColor": np.array([[0.55, 0.55, 0.56], [0.78, 0.79, 0.8], [0.93, 0.94, 0.95]]),
                "groundAngle": np.array([1.05, 1.57]),
            },
        ),
    ]
    for direction, intensity, color in _LIGHTS:
        fields = {
            "direction": np.array(direction),
            "intensity": intensity,
            "ambientIntensity": 0.25,
            "color": np.array(color),
        }
        nodes.append(Node("DirectionalLight", fields=fields))
    down = float(np.arctan2(eye - middle[1], back))
    for title, turn in _CAMERAS.items():
        position = middle + [np.sin(turn) * back, eye - middle[1], np.cos(turn) * back]
        fields = {
            "description": title,
            "position": position,
            "orientation": _axis_angle(turn, -down),
            "centerOfRotation": middle,
            "fieldOfView": _FIELD_OF_VIEW,
        }
        nodes.append(Node("Viewpoint", fields=fields))
    return nodes


def of_a_studio(reading: Reading, node: Node) -> bool:
    """Whether a node of a file is a light or a camera as `studio` makes them for every new scene."""
    if node.type not in ("DirectionalLight", "Viewpoint"):
        return False
    try:
        if node.type == "Viewpoint":
            view = reading.number(node, "fieldOfView", 0.785398)
            return reading.text(node, "description") in _CAMERAS and bool(np.isclose(view, _FIELD_OF_VIEW))
        own = reading.vector(node, "direction", (0.0, 0.0, -1.0))
    except FileError:  # what nobody needed to read till now may be damaged
        return False
    return any(np.allclose(own, direction) for direction, _, _ in _LIGHTS)


def _axis_angle(yaw: float, pitch: float) -> Array:
    """Axis and angle of a turn about Y after a turn about X."""
    cy, sy, cx, sx = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(pitch / 2), np.sin(pitch / 2)
    axis = np.array([cy * sx, sy * cx, -sy * sx])
    size = float(np.linalg.norm(axis))
    if size < 1e-12:
        return np.array([0.0, 0.0, 1.0, 0.0])
    return np.array([*(axis / size), 2 * np.arctan2(size, cy * cx)])
