"""vitruvian: virtual humans that comply with H-Anim (ISO/IEC 19774).

The public names are looked up when they are first used, so that `import vitruvian` stays fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

_WHERE = {
    "load": "formats.registry",
    "humanoids": "formats.registry",
    "save": "formats.registry",
    "check": "formats.registry",
    "Humanoid": "hanim.humanoid",
    "Skeleton": "body.types",
    "Skin": "body.types",
    "Body": "body.types",
    "pack": "body.pack",
    "joint_matrices": "body.kinematics",
    "Motion": "motion.types",
    "Markers": "motion.markers",
    "retarget": "motion.retarget",
    "motion_of": "motion.tracks",
    "reach": "motion.reach",
    "Goal": "motion.reach",
    "walk": "motion.gait",
    "idle": "motion.idle",
    "deformer": "deform.deformer",
    "person": "modeling.person",
    "fit": "modeling.fit",
    "contours": "modeling.contours",
    "transfer": "modeling.transfer",
    "reuse": "modeling.reuse",
    "decimate": "modeling.decimate",
    "tailor": "cloth.tailor",
    "Pattern": "cloth.pattern",
    "rearrange": "modeling.rearrange",
    "split": "modeling.parts",
    "join": "modeling.parts",
    "masses": "modeling.mass",
    "whole_body": "modeling.mass",
    "feature_points": "modeling.features",
    "add_feature_points": "modeling.features",
    "segment": "hanim.segmenting",
    "weld": "hanim.welding",
    "Mesh": "stage.clip",
    "Clip": "stage.clip",
    "Stage": "stage.stage",
    "show": "show.live",
    "VitruvianError": "errors",
    "FileError": "errors",
    "VitruvianWarning": "errors",
}
__all__ = sorted([*_WHERE, "__version__"])

if TYPE_CHECKING:
    from vitruvian.body.kinematics import joint_matrices as joint_matrices
    from vitruvian.body.pack import pack as pack
    from vitruvian.body.types import Body as Body
    from vitruvian.body.types import Skeleton as Skeleton
    from vitruvian.body.types import Skin as Skin
    from vitruvian.cloth.pattern import Pattern as Pattern
    from vitruvian.cloth.tailor import tailor as tailor
    from vitruvian.deform.deformer import deformer as deformer
    from vitruvian.errors import FileError as FileError
    from vitruvian.errors import VitruvianError as VitruvianError
    from vitruvian.errors import VitruvianWarning as VitruvianWarning
    from vitruvian.formats.registry import check as check
    from vitruvian.formats.registry import humanoids as humanoids
    from vitruvian.formats.registry import load as load
    from vitruvian.formats.registry import save as save
    from vitruvian.hanim.humanoid import Humanoid as Humanoid
    from vitruvian.hanim.segmenting import segment as segment
    from vitruvian.hanim.welding import weld as weld
    from vitruvian.modeling.contours import contours as contours
    from vitruvian.modeling.decimate import decimate as decimate
    from vitruvian.modeling.features import add_feature_points as add_feature_points
    from vitruvian.modeling.features import feature_points as feature_points
    from vitruvian.modeling.fit import fit as fit
    from vitruvian.modeling.mass import masses as masses
    from vitruvian.modeling.mass import whole_body as whole_body
    from vitruvian.modeling.parts import join as join
    from vitruvian.modeling.parts import split as split
    from vitruvian.modeling.person import person as person
    from vitruvian.modeling.rearrange import rearrange as rearrange
    from vitruvian.modeling.reuse import reuse as reuse
    from vitruvian.modeling.transfer import transfer as transfer
    from vitruvian.motion.gait import walk as walk
    from vitruvian.motion.idle import idle as idle
    from vitruvian.motion.markers import Markers as Markers
    from vitruvian.motion.reach import Goal as Goal
    from vitruvian.motion.reach import reach as reach
    from vitruvian.motion.retarget import retarget as retarget
    from vitruvian.motion.tracks import motion_of as motion_of
    from vitruvian.motion.types import Motion as Motion
    from vitruvian.show.live import show as show
    from vitruvian.stage.clip import Clip as Clip
    from vitruvian.stage.clip import Mesh as Mesh
    from vitruvian.stage.stage import Stage as Stage


def __getattr__(name: str) -> object:
    if name not in _WHERE:
        raise AttributeError(f"module 'vitruvian' has no attribute {name!r}")
    value = getattr(import_module(f"vitruvian.{_WHERE[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
