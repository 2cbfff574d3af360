"""What every benchmark answers: rows, all with the same fields, and the command line that prints them."""

from __future__ import annotations

import argparse
from collections.abc import Callable


def row(
    name: str,
    ours: float | None,
    peer: str | None,
    peer_s: float | None,
    ratio: float | None,
    goal: str,
    holds: bool,
    **more: object,
) -> dict[str, object]:
    """A measured figure: seconds of ours and the peer's, their ratio, the goal in words, and what else was seen."""
    shown = None if ratio is None else float(f"{ratio:.3g}")
    fixed = {"name": name, "ours_s": ours, "peer": peer, "peer_s": peer_s, "ratio": shown, "goal": goal, "holds": holds}
    return fixed | more


def main(doc: str | None, rows: Callable[[bool], list[dict[str, object]]]) -> None:
    """Run one benchmark file by itself: `python benchmarks/NAME.py [--quick]`."""
    from vitruvian.cli.showing import benchmark_line

    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer repetitions")
    for found in rows(parser.parse_args().quick):
        print(benchmark_line(found))
