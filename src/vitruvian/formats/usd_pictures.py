"""Pictures of USD materials, in and out; the reading half runs where `usd_stage` does.

Source: UsdPreviewSurface (UsdUVTexture, UsdPrimvarReader_float2) of the UsdShade documentation of OpenUSD.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from vitruvian.formats.usd import Stage
    from vitruvian.hanim.humanoid import Picture

_MOST = 1 << 25  # bytes of one picture
_ALL = 1 << 28  # of all pictures of a file
_CLAMPED = ("clamp", "black")


class Found:
    """Pictures that materials name, each once, opened only from `home` and below."""

    def __init__(self, home: Path, notes: list[str]):
        self.home, self.notes = Path(os.path.realpath(home)), notes
        self.entries: list[dict[str, Any]] = []
        self._known: dict[str, int | None] = {}
        self._size = 0

    def of(self, color: Any, opacity: Any, threshold: Any) -> dict[str, Any]:
        """What a part gets from the texture behind its diffuseColor: `picture` and, of a tint, `color`."""
        from pxr import UsdShade

        shader = UsdShade.Shader(color.GetConnectedSources()[0][0].source.GetPrim())
        if str(shader.GetIdAttr().Get()) != "UsdUVTexture":
            return {}
        number = self._open(shader.GetInput("file"))
        if number is None:
            return {}
        wrap = [_word(shader, name) not in _CLAMPED for name in ("wrapS", "wrapT")]
        alpha = ""
        if opacity and opacity.HasConnectedSource():
            cut = threshold.Get() if threshold else None
            alpha = "mask" if cut else "blend"
        out: dict[str, Any] = {"picture": {"number": number, "repeat": wrap, "alpha": alpha}, "color": [1.0, 1.0, 1.0]}
        scale = shader.GetInput("scale")
        if scale and scale.Get() is not None and len(scale.Get()) >= 3:
            out["color"] = [min(max(float(c), 0.0), 1.0) for c in list(scale.Get())[:3]]
        return out

    def _open(self, given: Any) -> int | None:
        """The number of the picture that a shader's input names, None when it can't be used."""
        value = given.Get() if given else None
        name = value.path if value else ""
        stack = given.GetAttr().GetPropertyStack() if given else []
        layer = next((s.layer.realPath for s in stack if s.HasDefaultValue()), "")
        if not name or not layer:
            return None
        key = f"{layer}\0{name}"
        if key not in self._known:
            self._known[key] = self._read(Path(layer).parent, name)
        return self._known[key]

    def _read(self, folder: Path, name: str) -> int | None:
        shown = " ".join(name.split())[:80]
        if "://" in name or "\0" in name or "[" in name or os.path.isabs(name):
            self.notes.append(f"the picture {shown} is not a file beside this one; it is left out")
            return None
        try:
            target = Path(os.path.realpath(folder / name))
            if not target.is_relative_to(self.home) or not target.is_file() or target.stat().st_size > _MOST:
                self.notes.append(f"the picture {shown} is not beside this file, or too large; it is left out")
                return None
            data = target.read_bytes()
        except (OSError, ValueError):
            return None
        self._size += len(data)
        if self._size > _ALL:
            self.notes.append(f"more than {_ALL >> 20} MB of pictures; {shown} is left out")
            return None
        self.entries.append({"name": target.stem, "data": np.frombuffer(data, np.uint8)})
        return len(self.entries) - 1


def _word(shader: Any, name: str) -> str:
    given = shader.GetInput(name)
    return str(given.Get()) if given else ""


def attach(document: dict[str, Any]) -> None:
    """In the answer of `usd_stage`: the Picture of each part in place of its number."""
    from vitruvian.errors import warn
    from vitruvian.formats.pictures import kind
    from vitruvian.hanim.humanoid import Picture

    held = [(str(e["name"])[:100], e["data"].tobytes()) for e in document["pictures"]]
    for mesh in [*document["meshes"], *(m for f in document["figures"] for m in f["meshes"])]:
        for part in mesh["parts"]:
            given = part.pop("picture", None)
            if given is None:
                continue
            name, data = held[given["number"]]
            if kind(data) is None:
                warn(f"the picture {name} is no PNG or JPEG, or too large; it is left out")
                continue
            first, second = given["repeat"]
            part["picture"] = Picture(name, data, repeat=(bool(first), bool(second)), alpha=str(given["alpha"]))


def texture(stage: Stage, path: Any, shader: Any, picture: Picture, tint: tuple[float, ...]) -> bool:
    """Let a picture colour a surface shader, times `tint` (linear); False when it is not at hand."""
    from pxr import Gf, Sdf, UsdShade

    from vitruvian.formats.pictures import content, transparent

    found = content(picture)
    if found is None:
        stage.pictures.miss(picture)
        return False
    types = Sdf.ValueTypeNames
    st = UsdShade.Shader.Define(stage.usd, path.AppendChild("st"))
    st.CreateIdAttr("UsdPrimvarReader_float2")
    st.CreateInput("varname", types.String).Set("st")
    image = UsdShade.Shader.Define(stage.usd, path.AppendChild("picture"))
    image.CreateIdAttr("UsdUVTexture")
    image.CreateInput("file", types.Asset).Set(Sdf.AssetPath(f"./{stage.pictures.file(picture.name, *found)}"))
    image.CreateInput("st", types.Float2).ConnectToSource(st.CreateOutput("result", types.Float2))
    for name, on in zip(("wrapS", "wrapT"), picture.repeat):
        image.CreateInput(name, types.Token).Set("repeat" if on else "clamp")
    image.CreateInput("sourceColorSpace", types.Token).Set("sRGB")
    if any(t != 1 for t in tint):
        image.CreateInput("scale", types.Float4).Set(Gf.Vec4f(*tint, 1.0))
    diffuse = shader.CreateInput("diffuseColor", types.Color3f)
    diffuse.ConnectToSource(image.CreateOutput("rgb", types.Float3))
    if picture.alpha and transparent(found[0]):
        shader.CreateInput("opacity", types.Float).ConnectToSource(image.CreateOutput("a", types.Float))
        if picture.alpha == "mask":
            shader.CreateInput("opacityThreshold", types.Float).Set(0.5)
    return True
