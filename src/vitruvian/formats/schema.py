"""What the X3D XML schemas of the Web3D Consortium say about a file (rule F09), their own known defects left out.

The schemas of X3D 3.3 (for 3.0 to 3.3) and 4.0 come with the package, unchanged but packed (hanim/data/xsd, with their
licence). Nothing is fetched: includes are answered from the package, a DOCTYPE is cut off before parsing.
"""

from __future__ import annotations

import lzma
import re
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from vitruvian.formats.source import LIMITS, read_bytes
from vitruvian.hanim.doctor import Finding, finding

_DOCTYPE = re.compile(rb"<!DOCTYPE[^>\[]*(?:\[[^\]]*\]\s*)?>")
_MOST = 20  # complaints that are reported one by one
# What the standard allows though the schemas do not: (complaint, rule that tells of it instead or "").
_DEFECTS = (
    (re.compile(r"Element 'HAnimDisplacer': This element is not expected"), "D02"),
    (re.compile(r"Element 'HAnimMotion', attribute 'name': The attribute 'name' is not allowed"), ""),
    (re.compile(r"attribute 'jointBindingScales'"), ""),
)


def complaints(path: str | Path) -> list[Finding]:
    """F09 for an X3D XML file: one finding per complaint of the schema of its version, one for many of the same kind.

    A displacer of a joint, which the standard allows and the schema of 4.0 refuses, is D02. A file that is not
    well-formed has no findings here (it is F02).
    """
    from lxml import etree

    data = _DOCTYPE.sub(lambda m: b"\n" * m[0].count(b"\n"), read_bytes(path, LIMITS), count=1)
    parser = etree.XMLParser(resolve_entities=False, load_dtd=False, no_network=True, huge_tree=True)
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError):
        return []
    schema = _schema("3.3" if (root.get("version") or "").startswith("3.") else "4.0")
    if schema.validate(root):
        return []
    kinds: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for error in schema.error_log:
        rule = next((rule for defect, rule in _DEFECTS if defect.search(error.message)), "F09")
        if rule:
            message = " ".join(error.message.split())
            kind = re.sub(r"'[^']*'", "'", message) if rule == "F09" else rule
            kinds.setdefault((rule, kind), []).append((error.line, message[:220]))
    found = []
    for (rule, _), cases in list(kinds.items())[:_MOST]:
        line, message = cases[0]
        more = f" ({len(cases)} times)" if len(cases) > 1 else ""
        if rule == "D02":
            message = f"the schema refuses a displacer under a joint{more}, though the standard allows it"
            found.append(finding(rule, "displacer", line, message, "move it to a segment for strict tools"))
        else:
            found.append(finding(rule, "schema", line, message + more, "as the message says"))
    return found


@cache
def _schema(version: str) -> Any:
    """The compiled schema: about half a second once."""
    from lxml import etree

    class FromPackage(etree.Resolver):
        def resolve(self, url: str, public_id: str, context: Any = None) -> Any:
            name = url.rpartition("/")[2]
            return self.resolve_string(_text(name) if _packed(name).is_file() else b"<none/>", context, base_url=name)

    parser = etree.XMLParser(no_network=True, load_dtd=False)
    parser.resolvers.add(FromPackage())
    name = f"x3d-{version}.xsd"
    return etree.XMLSchema(etree.fromstring(_text(name), parser, base_url=name))


def _packed(name: str) -> Any:
    return files("vitruvian.hanim") / "data" / "xsd" / f"{name}.xz"


def _text(name: str) -> bytes:
    return lzma.decompress(_packed(name).read_bytes())
