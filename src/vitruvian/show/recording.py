"""A clip as one HTML file that plays from disk: the page, three.js and the same messages that the server sends.

No network: everything is inside, and a content security policy forbids the page to ask for anything.
"""

from __future__ import annotations

import base64
import re
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np

from vitruvian.deform.normals import incidence, mesh_normals
from vitruvian.errors import VitruvianError
from vitruvian.show.actors import PAGE, SERVED, Actor, actors_of
from vitruvian.show.live import finding_fields
from vitruvian.show.server import FOLDER, MODULES
from vitruvian.show.showing import Showing
from vitruvian.show.wire import Block, encode, quantise, quantise_normals
from vitruvian.stage.clip import Clip, Mesh
from vitruvian.stage.vertex_cache import VertexCache

LIMIT = 200e6  # bytes of frames before compression; more is refused

# Unpacks the modules in the order of their imports and links them by blob addresses; classic script, runs from file://.
LOADER = """
(async () => {
  const unpack = async (id) => {
    const text = document.getElementById(id).textContent, bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };
  const files = JSON.parse(new TextDecoder().decode(await unpack("vitruvian-code"))), urls = {};
  for (const [name, text] of files) {
    const linked = text.replace(/(from\\s*)(["'])([^"'\\n]+)\\2/g, (all, from, quote, path) => {
      const url = urls[path.split("/").pop()] ?? (path === "three" ? urls["three.module.js"] : undefined);
      return url ? from + quote + url + quote : all;
    });
    urls[name.split("/").pop()] = URL.createObjectURL(new Blob([linked], { type: "text/javascript" }));
  }
  const page = await import(urls["main.js"]);
  await page.start({ recording: await unpack("vitruvian-clip") });
})().catch((error) => {
  document.getElementById("notice").textContent = "This recording can't be played here: " + error.message;
  throw error;
});
"""


def record(
    thing: object,
    path: str | Path,
    *beside: object,
    findings: Sequence[object] = (),
    title: str = "",
    compare: bool = False,
) -> dict[str, int]:
    """Write one self-contained HTML file that plays a Clip (or Humanoid, Body, Mesh, Heat), and what stands beside it,
    without server or network.

    Returns `{"bytes", "frames"}`. Raises `VitruvianError` when the clip is too long for one file. The page runs every
    deformer that the body is able to by itself, and compares them; with `compare` also with the body in contours.
    """
    actors, caches = cast([thing, *beside], compare=compare)
    showing = Showing(
        actors,
        [finding_fields(f) for f in findings],
        title,
        leave=(*PAGE, *SERVED),
    )
    clip = b"".join(_framed(m) for m in messages(showing, caches))
    code = [[name, (FOLDER / name).read_text("utf-8")] for name in _ordered()]
    html = (FOLDER / "index.html").read_text("utf-8")
    html = _replace(html, r"<script type=\"importmap\">.*?</script>\s*", "")
    style = (FOLDER / "style.css").read_text("utf-8")
    html = _replace(html, r"<link rel=\"stylesheet\"[^>]*>", lambda _: f"<style>\n{style}</style>")
    policy = (
        "default-src 'none'; script-src 'unsafe-inline' blob:; style-src 'unsafe-inline'; img-src data: blob:; "
        "connect-src 'none'; base-uri 'none'; form-action 'none'"
    )
    html = _replace(
        html, r"<meta charset=\"utf-8\">", f'\\g<0>\n<meta http-equiv="Content-Security-Policy" content="{policy}">'
    )
    html = _replace(html, r"<title>.*?</title>", lambda _: f"<title>{escape(showing.title)}</title>")
    data = "\n".join(
        f'<script type="application/octet-stream" id="{name}">{_packed(part)}</script>'
        for name, part in (("vitruvian-code", _json(code)), ("vitruvian-clip", clip))
    )
    licence = (FOLDER / "vendor" / "LICENSE-three.txt").read_text("utf-8")
    notice = f"<!-- three.js, inside this file, is distributed under this licence:\n{licence}-->"
    script = f"{notice}\n{data}\n<script>{LOADER}</script>"
    html = _replace(html, r"<script type=\"module\"[^>]*></script>", lambda _: script)
    blob = html.encode()
    from vitruvian.formats.atomic import atomic

    with atomic(path) as temporary:
        Path(temporary).write_bytes(blob)
    return {"bytes": len(blob), "frames": showing.frames}


def cast(things: Sequence[object], *, compare: bool = False) -> tuple[list[Actor], dict[str, VertexCache]]:
    """The actors of a recording, `compare` as for `actors_of`, and what those of clothes do, by name: as it was computed
    ahead for their Clips, or is now."""
    from vitruvian.stage.baking import bake

    bare: list[object] = []
    worn: list[tuple[int, VertexCache]] = []
    for k, thing in enumerate(things):
        if isinstance(thing, Clip) and (thing.garment is not None or thing.caches):
            worn += [(k, cache) for cache in thing.caches or bake(thing)]
            thing = replace(thing, garment=None, caches=())
        bare.append(thing)
    first = [cache.positions[0].astype(np.float64) for _, cache in worn]
    meshes = [
        Mesh(x, c.triangles, c.uv, np.tile(c.color, (len(x), 1)), c.name, uv_triangles=c.uv_triangles)
        for x, (_, c) in zip(first, worn)
    ]
    actors, caches = actors_of([*bare, *meshes], compare=compare), {}
    for k, (wearer, cache) in enumerate(worn, len(bare)):
        actors[k] = replace(actors[k], on=actors[wearer], fps=actors[wearer].fps)
        caches[actors[k].name] = cache
    return actors, caches


def _clothes(caches: Mapping[str, VertexCache], n: int) -> list[Block]:
    """The blocks of clothes in frame n."""
    out = []
    for name, cache in caches.items():
        points = cache.positions[min(n, len(cache) - 1)]
        q, scale, origin = quantise(points)
        normals = mesh_normals(incidence(points.astype(np.float64), cache.triangles), points[None])[0]
        out += [Block("vertices", q, name, scale, origin), Block("normals", quantise_normals(normals), name)]
    return out


def messages(showing: Showing, caches: Mapping[str, VertexCache] | None = None) -> list[bytes]:
    """Every message of a recording: hello, pictures, meshes, then one frame message per frame, complete in itself. caches:
    what clothes do, see `cast`."""
    meshes = showing.meshes
    out = [showing.hello(), *showing.pictures.values(), *meshes]
    stage, size = showing.stage, 0
    for n in range(showing.frames):
        stage.seek(n / showing.fps)
        blocks = showing.blocks(stage.step(0)) + _clothes(caches or {}, n)
        fields = {"seq": 0, "tick": n, "t": n / showing.fps, "frame": n, "round": 0}
        out.append(encode("frame", fields | {"deformers": showing.deformers}, blocks))
        size += len(out[-1])
        if size > LIMIT:
            raise VitruvianError(f"record: {showing.frames} frames are too many for one page; cut the clip shorter")
    return out


def _framed(message: bytes) -> bytes:
    return struct.pack("<II", len(message), 0) + message + bytes(-len(message) % 8)


def _packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode()


def _json(value: object) -> bytes:
    import json

    return json.dumps(value, ensure_ascii=False).encode()


def _replace(html: str, pattern: str, by: object) -> str:
    out, n = re.subn(pattern, by, html, count=1, flags=re.S)  # type: ignore[call-overload]
    if n != 1:
        raise VitruvianError(f"record: the page has no {pattern}")
    return out


def _ordered() -> list[str]:
    """Modules such that each comes after those that it imports."""
    base = {name.rsplit("/", 1)[-1]: name for name in MODULES}
    out: list[str] = []

    def visit(name: str) -> None:
        if name in out:
            return
        text = (FOLDER / name).read_text("utf-8")
        for path in re.findall(r"^(?:import|export|\})[^;]*?from\s*[\"']([^\"'\n]+)[\"']", text, re.M):
            leaf = "three.module.js" if path == "three" else path.rsplit("/", 1)[-1]
            if leaf in base and base[leaf] != name:
                visit(base[leaf])
        out.append(name)

    visit("main.js")
    return out
