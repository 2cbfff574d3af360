"""Patterns of our own, drafted from a body's measures by the rules of block drafting.

Each is a function of measures (metres, names as in `person --measure`) that answers a Pattern whose panels stand around
the body. Sources: note cloth.md, sections 2.1 and 14; W. Aldrich, "Metric Pattern Cutting" (5th ed., 2008), for the order
of constructions and usual amounts of ease; the Roman garments are rectangles, after L. M. Wilson, "The Clothing of the
Ancient Romans" (1938).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any

from vitruvian.cloth.drafting.bottoms import circle_skirt, skirt, trousers
from vitruvian.cloth.drafting.tops import dress, shirt, tshirt
from vitruvian.cloth.drafting.wraps import toga, tunic
from vitruvian.cloth.pattern import Pattern
from vitruvian.errors import VitruvianError

DRAFTS: Mapping[str, Callable[..., Pattern]] = MappingProxyType(
    {
        "tshirt": tshirt,
        "shirt": shirt,
        "trousers": trousers,
        "skirt": skirt,
        "circle-skirt": circle_skirt,
        "dress": dress,
        "tunic": tunic,
        "toga": toga,
    }
)


def drafted(name: str, measures: Mapping[str, float], **options: Any) -> Pattern:
    """The pattern of that name in `DRAFTS` for a body of these measures, metres.

    Raises VitruvianError for a name that is not there, options that the draft does not have, and measures or options of
    which no such garment can be made.
    """
    if name not in DRAFTS:
        near = get_close_matches(name, DRAFTS, 1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise VitruvianError(f"draft: expected one of {', '.join(DRAFTS)}, found {name!r:.60}{hint}")
    draft = DRAFTS[name]
    known = draft.__kwdefaults__ or {}
    strange = next((o for o in options if o not in known), None)
    if strange is not None:
        raise VitruvianError(f"{name}: expected options {', '.join(known)}, found {strange!r:.60}")
    return draft(measures, **options)
