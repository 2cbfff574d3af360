"""Universal Scene Description to Humanoids and Meshes.

The file is opened in a process of its own (`usd_stage`); here its arrays become ours. Bridge, the other way round than
in `usd_figure` and for any rig: with B_j the bind transform of a joint, X_j its local transform and p its parent,
L_j = B_p X_j B_j^-1 is what turns the figure at j in its own space, whatever way the joint's axes point at rest. Its
3x3 part is a rotation times a stretch along scaleOrientation, and the joint's translation is where it takes the centre.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.errors import FileError, warn
from vitruvian.formats import usd_stage
from vitruvian.formats.usd import require_usd
from vitruvian.formats.usd_build import humanoid_of
from vitruvian.formats.usd_pictures import attach
from vitruvian.formats.usd_shapes import mesh_of
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.stage.clip import Mesh

# where USD would look for plug-ins and files beside the ones we look at
_ELSEWHERE = ("PXR_PLUGINPATH_NAME", "PXR_AR_DEFAULT_SEARCH_PATH", "PXR_USDMTLX_PLUGIN_SEARCH_PATHS")
_KILLED = (9, 24)  # by the system: at the end of its memory, of its time


def read_usd(path: str | os.PathLike[str], *, seconds: int = 30) -> list[Humanoid | Mesh]:
    """What a .usd, .usda, .usdc or .usdz file holds: a Humanoid for each skeleton, in metres and Y up, then one Mesh
    of everything that no skeleton moves.

    Joints take the names of H-Anim where their own are known (the tables of retargeting); a SkelAnimation becomes the
    humanoid's motion, BlendShapes its Displacers. What other files say is used only from the file's folder and below.
    `seconds`: how long a processor may work on opening the file, which can ask for any amount of work.
    Raises `MissingExtra` without usd-core and `FileError` for files that can't be read or hold neither.
    """
    require_usd()
    document = _read(Path(path), seconds)
    attach(document)
    for note in document["notes"][:10]:
        warn(f"{path}: {note}")
    try:
        found: list[Humanoid | Mesh] = [humanoid_of(path, f, document) for f in document["figures"]]
    except (AttributeError, KeyError, TypeError, ValueError) as error:  # words where numbers are meant, and the like
        what = f"expected the H-Anim facts in customData to be as vitruvian writes them, found others ({error})"
        raise FileError(path, 0, what) from error
    if any(len(m["points"]) for m in document["meshes"]):
        found.append(mesh_of(document))
    if not found:
        raise FileError(path, 0, "expected a UsdSkel skeleton or a mesh, found neither")
    return found


def _read(path: Path, seconds: int) -> dict[str, Any]:
    """The answer of `usd_stage`, arrays in their places."""
    if path.stat().st_size > usd_stage.MAX_BYTES:
        raise FileError(path, 0, f"expected a USD file of at most {usd_stage.MAX_BYTES >> 20} MB")
    environment = {k: v for k, v in os.environ.items() if k not in _ELSEWHERE}
    environment |= {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "PXR_WORK_THREAD_LIMIT": "1"}
    with tempfile.TemporaryDirectory(prefix="vitruvian-usd-") as folder:
        command = [sys.executable, "-m", usd_stage.__name__, os.path.abspath(path), folder, str(seconds)]
        late = FileError(path, 0, f"takes more than {seconds} s to open")
        try:
            done = subprocess.run(command, env=environment, capture_output=True, timeout=4 * seconds)
        except subprocess.TimeoutExpired:
            raise late from None
        out = Path(folder) / "out.npz"
        if -done.returncode in _KILLED:
            raise late
        if done.returncode or not out.is_file():
            words = done.stderr.decode("utf-8", "replace").strip().splitlines()
            why = (
                f"it crashed, signal {-done.returncode}" if done.returncode < 0 else (words or ["no reason given"])[-1]
            )
            raise FileError(path, 0, f"the USD library gave up on this file ({why})")
        with np.load(out, allow_pickle=False) as arrays:
            document = _filled(json.loads(arrays["document"].tobytes()), arrays)
    if "error" in document:
        raise FileError(path, 0, document["error"])
    return document


def _filled(value: Any, arrays: Any) -> Any:
    if isinstance(value, dict):
        if list(value) == ["array"]:
            return arrays[value["array"]]
        return {k: _filled(v, arrays) for k, v in value.items()}
    return [_filled(v, arrays) for v in value] if isinstance(value, list) else value
