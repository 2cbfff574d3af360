"""How the doctor counts and lists things in a sentence."""

from __future__ import annotations

_SHOWN = 3


def some(names: list[str]) -> str:
    """The first few of many names."""
    return ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def several(number: int, one: str, many: str) -> str:
    """ "1 joint is" or "3 joints are" for the words "joint is" and "joints are"."""
    return f"1 {one}" if number == 1 else f"{number:,} {many}"


def closest(word: str, words: list[str]) -> str:
    """The nearest of the words, "" when none is near."""
    import difflib

    near = difflib.get_close_matches(word, words, n=1, cutoff=0.75)
    return near[0] if near else ""
