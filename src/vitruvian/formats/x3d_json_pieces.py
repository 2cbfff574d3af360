"""What the reader of X3D JSON takes out of objects and lists, with the variants that files have."""

from __future__ import annotations

from collections.abc import Iterator

from vitruvian.errors import warn
from vitruvian.formats.json_tree import List, Object, Span, Tree, Value
from vitruvian.formats.scopes import Scopes
from vitruvian.formats.source import Limits
from vitruvian.hanim.graph import Comment, Literal


class Pieces:
    """A JSON tree and what counts the things in it."""

    def __init__(self, tree: Tree, scopes: Scopes, limits: Limits):
        self.tree, self.path, self.scopes, self.limits = tree, tree.path, scopes, limits

    def warn(self, place: int, what: str) -> None:
        warn(f"{self.path}:{self.tree.line(place)}: {what}")

    def word(self, holder: Object, key: str, default: str = "") -> str:
        """A string of an object, `default` when it isn't given."""
        if key not in holder.items:
            return default
        place, value = holder.items[key]
        if isinstance(value, Span) and self.tree.source(value) == "null":
            return default
        text = self.tree.string(value)
        if text is None:
            texts = self.tree.strings(value)
            if isinstance(value, Object) or len(texts) > 1:
                raise self.tree.fail(place, f"expected {key} to be a string")
            text = "".join(texts)
        return text

    def literal(self, key: str, place: int, value: Value) -> Literal:
        """A field's value as it stands."""
        if isinstance(value, List):
            inner = [v for v in value.items if not isinstance(v, Span)]
            if any(isinstance(v, Object) or v.items for v in inner):
                raise self.tree.fail(place, f"expected {key} to be a value or a list of values, found objects in it")
        elif isinstance(value, Object):
            raise self.tree.fail(place, f"expected {key} to be a value, found an object")
        return Literal(self.tree.source(value), "json", self.tree.line(place))

    def comments(self, place: int, value: Value) -> list[Comment]:
        line = self.tree.line(place)
        found = [Comment(text, line) for text in self.tree.strings(value)]
        self.scopes.count(line, 0, len(found))
        return found

    def objects(self, key: str, value: Value) -> Iterator[Object]:
        """The objects of a list, or the one that stands for a list of one."""
        for item in value.items if isinstance(value, List) else [value]:
            if isinstance(item, Object):
                yield item
            else:
                self.warn(item.start, f"{self.tree.found(item.start)} in {key} is left out")

    def entries(self, value: Value) -> Iterator[tuple[str, int, Value]]:
        """(type or keyword, place, content) of everything in a list of nodes."""
        for item in value.items if isinstance(value, List) else [value]:
            if isinstance(item, Object):
                for key, (place, content) in item.items.items():
                    yield from self.entry(key, place, content)
            elif self.tree.string(item) != "null":
                self.warn(item.start, f"expected a node, found {self.tree.found(item.start)}, which is left out")

    def entry(self, key: str, place: int, content: Value) -> Iterator[tuple[str, int, Value]]:
        if isinstance(content, List) and key[:1] != "#":
            for each in content.items:
                yield key, each.start, each
        else:
            yield key, place, content

    def number(self, entry: Object, key: str) -> float:
        text = self.word(entry, key, "1")
        try:
            number = float(text)
            if abs(number) < 1e300:
                return number
        except ValueError:
            pass
        raise self.tree.fail(entry.items[key][0], f"expected {key} to be a number, found {text[:40]!r}")
