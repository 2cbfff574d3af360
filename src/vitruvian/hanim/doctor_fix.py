"""The doctor's repairs: what has one right answer is put right in the graph, everything else stays as it is.

Each step is a function of a figure (or of the whole scene) that changes the graph and yields what it did in words,
with the rule in brackets. Which rules are repaired always and which on request stands in `doctor_rules`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from vitruvian.errors import VitruvianError
from vitruvian.hanim.doctor import Chart
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.doctor_rules import RULES
from vitruvian.hanim.graph import Export, Node, Route, Scene, Use

_PASSES = 4  # one repair may uncover another: a dropped pair leaves a sum of weights that is not 1
_FIGURES = 100  # humanoids of a file that are repaired
Wanted = frozenset[str]


def requested(also: Iterable[str]) -> Wanted:
    """The rules that are repaired: those always repaired and those asked for ("all" for every one that can be).

    VitruvianError for a rule that does not exist or has no repair.
    """
    always = {r.id for r in RULES.values() if r.auto in {"yes", "part"}}
    more = set()
    for word in also:
        if word.lower() == "all":
            more |= {r.id for r in RULES.values() if r.auto in {"opt", "part"}}
            continue
        rule = RULES.get(word.upper())
        if rule is None or rule.auto == "no":
            able = " ".join(r.id for r in RULES.values() if r.auto in {"opt", "part"})
            what = "is no rule" if rule is None else "has no repair"
            raise VitruvianError(f"--also: {word} {what}; expected some of {able}, or all")
        more.add(rule.id)
    return frozenset(always | {f"{rule}+" for rule in more} | more)


def mend(scene: Scene, path: object = None, *, also: Iterable[str] = ()) -> list[str]:
    """Repair a scene in place; answers one line per repair, [] when there was nothing to do (so: idempotent).

    `also` names rules that are repaired only on request (`auto` "opt", and all of "part"), "all" for all of them.
    Of a file with more than a hundred humanoids the first hundred are repaired.
    """
    from vitruvian.hanim import (
        doctor_fix_file,
        doctor_fix_motion,
        doctor_fix_names,
        doctor_fix_pose,
        doctor_fix_skin,
        doctor_fix_values,
    )

    wanted = requested(also)
    of_scene: list[Callable[[Chart, Wanted], Iterator[str]]] = [*doctor_fix_file.STEPS, *doctor_fix_values.SCENE_STEPS]
    of_figure: list[Callable[[Figure, Wanted], Iterator[str]]] = [
        *doctor_fix_names.STEPS,
        *doctor_fix_values.STEPS,
        *doctor_fix_skin.STEPS,
        *doctor_fix_pose.STEPS,
        *doctor_fix_motion.STEPS,
    ]
    done: list[str] = []
    for _ in range(_PASSES):
        lines: list[str] = []
        chart = Chart(scene, path)  # made anew after each change: every step sees what the one before it left
        for scene_step in of_scene:
            said = list(scene_step(chart, wanted))
            chart = Chart(scene, path) if said else chart
            lines += said
        for node in [n for n in chart.nodes if chart.reading.kind(n) == "Humanoid"][:_FIGURES]:
            figure = Figure(chart, node)
            for step in of_figure:
                where = f"humanoid {figure.chart.text(node, 'name') or node.name}".strip()
                said = [f"{where}: {what}" for what in step(figure, wanted)]
                figure = Figure(Chart(scene, path), node) if said else figure
                lines += said
            chart = figure.chart
        for scene_step in doctor_fix_motion.SCENE_STEPS:
            said = list(scene_step(chart, wanted))
            chart = Chart(scene, path) if said else chart
            lines += said
        done += lines
        if not lines:
            break
    return done


def entries(node: Node, field: str) -> list[Node | Use]:
    """Nodes and USEs of a node-valued field."""
    value = node.fields.get(field)
    return [v for v in (value if isinstance(value, list) else [value]) if isinstance(v, Node | Use)]


def target(entry: Node | Use) -> Node | None:
    """The node behind an entry."""
    return entry.node if isinstance(entry, Use) else entry


def take(node: Node, field: str, entry: Node | Use) -> None:
    """Take an entry out of a field; the field goes when nothing is left in it."""
    value = node.fields.get(field)
    if isinstance(value, list):
        rest = [v for v in value if v is not entry]
        node.fields[field] = rest
        if not any(isinstance(v, Node | Use) for v in rest):
            del node.fields[field]
    elif value is entry:
        del node.fields[field]
    node.order = []


_LISTS = ("joints", "segments", "sites")


def put(node: Node, field: str, entry: Node | Use) -> None:
    """Add an entry to a field. A DEF goes before the lists that USE it."""
    entry.container = field
    value = node.fields.get(field)
    if isinstance(value, list):
        value.append(entry)
    elif value is None or not isinstance(value, Node | Use):
        node.fields[field] = [entry]
    else:
        node.fields[field] = [value, entry]
    if isinstance(entry, Node) and field not in _LISTS:
        late = {f: node.fields.pop(f) for f in list(node.fields) if f in _LISTS}
        node.fields.update(late)
    node.order = []


class Names:
    """DEF names of a scene: which are taken, and who must follow when one changes."""

    def __init__(self, scene: Scene):
        self.scene = scene
        self.taken = {n.name for n in scene.walk() if n.name}
        self.last: dict[str, int] = {}  # the number that a name was given last
        self.uses: dict[int, list[Use]] = {}
        for node in scene.walk():
            for _, entry in node.entries():
                if isinstance(entry, Use) and entry.node is not None:
                    self.uses.setdefault(id(entry.node), []).append(entry)
        self.routes: dict[str, list[Route]] = {}
        self.exports: dict[str, list[Export]] = {}
        for statement in scene.body:
            if isinstance(statement, Use) and statement.node is not None:
                self.uses.setdefault(id(statement.node), []).append(statement)
            elif isinstance(statement, Route):
                for end in {statement.from_node, statement.to_node}:
                    self.routes.setdefault(end, []).append(statement)
            elif isinstance(statement, Export):
                self.exports.setdefault(statement.name, []).append(statement)

    def free(self, wanted: str) -> str:
        """`wanted`, numbered when it is taken; taken from now on."""
        name, n = wanted, self.last.get(wanted, 1)
        while name in self.taken:
            n += 1
            name = f"{wanted}_{n}"
        self.last[wanted] = n
        self.taken.add(name)
        return name

    def rename(self, node: Node, new: str, *, alone: bool = True) -> None:
        """Give a node another DEF; USEs, ROUTEs and EXPORTs follow.

        When another node has the old name too (`alone` False), only ROUTEs after this node mean it.
        """
        old, node.name = node.name, new
        for use in self.uses.get(id(node), ()):
            use.name = new
        for route in self.routes.pop(old, []):
            follows = alone or not route.line or route.line >= node.line
            if follows:
                route.from_node = new if route.from_node == old else route.from_node
                route.to_node = new if route.to_node == old else route.to_node
            self.routes.setdefault(new if follows else old, []).append(route)
        for export in self.exports.pop(old, []) if alone else ():
            export.alias, export.name = export.alias or old, new
