"""One thread for linear algebra: on small matrices, and beside other work, more of them are slower by far."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

PREFIXES, ENDS = ("scipy_openblas", "openblas"), ("64_", "")


@cache
def _counters() -> tuple[tuple[Callable[[], int], Callable[[int], None]], ...]:
    """Getter and setter of the number of threads in each OpenBLAS that numpy and scipy bring along."""
    import numpy
    import scipy

    out = []
    for package in (numpy, scipy):
        home = Path(str(package.__file__)).parent
        for folder in (home.parent / f"{home.name}.libs", home / ".dylibs"):
            for file in sorted(folder.glob("*openblas*")):
                try:
                    library = ctypes.CDLL(str(file))
                except OSError:
                    continue
                for name in ((p, e) for p in PREFIXES for e in ENDS):
                    getter = getattr(library, f"{name[0]}_get_num_threads{name[1]}", None)
                    setter = getattr(library, f"{name[0]}_set_num_threads{name[1]}", None)
                    if getter is not None and setter is not None:
                        out.append((getter, setter))
                        break
    return tuple(out)


@contextmanager
def one_thread() -> Iterator[None]:
    """Within, OpenBLAS computes with one thread; other libraries for linear algebra are left as they are."""
    before = [getter() for getter, _ in _counters()]
    for _, setter in _counters():
        setter(1)
    try:
        yield
    finally:
        for (_, setter), count in zip(_counters(), before, strict=True):
            setter(count)
