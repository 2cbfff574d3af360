"""Many pictures at once: `render` in several processes, results in order.

Each worker is this module run by the same Python. It gets one job at a time through its standard input and answers
through its standard output, so that nothing depends on how processes are forked and scripts need no guard.
"""

from __future__ import annotations

import os
import pickle
import struct
import subprocess
import sys
from collections.abc import Iterable, Iterator
from typing import IO, Any

from vitruvian.errors import VitruvianError
from vitruvian.show.render import Pixels, render

Job = tuple[Any, ...]  # the positional arguments of `render` and a dict of its options


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def develop(jobs: Iterable[Job], processes: int | None = None) -> Iterator[Pixels]:
    """The picture of each job (surfaces, camera, size, options), in order. processes None: one per processor.

    The pictures do not depend on the number of processes. Raises `VitruvianError` when a worker fails.
    """
    count = processors() if processes is None else processes
    if count <= 1:
        for *arguments, options in jobs:
            yield render(*arguments, **options)
        return
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-m", "vitruvian.show.darkroom"]
    workers: list[subprocess.Popen[bytes]] = []
    waiting: list[subprocess.Popen[bytes]] = []  # in the order of their jobs
    try:
        for job in jobs:
            if len(workers) < count:
                worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
                workers.append(worker)
            else:
                worker = waiting.pop(0)
                yield _answer(worker)
            waiting.append(worker)
            try:
                _send(worker.stdin, job)
            except BrokenPipeError:
                raise VitruvianError(f"film: a worker ended with status {worker.wait()}") from None
        while waiting:
            yield _answer(waiting.pop(0))
    finally:
        for worker in workers:
            worker.kill()
            worker.communicate()


def _answer(worker: subprocess.Popen[bytes]) -> Pixels:
    try:
        answer = _receive(worker.stdout)
    except EOFError:
        raise VitruvianError(f"film: a worker ended with status {worker.wait()}") from None
    if isinstance(answer, Exception):
        raise answer
    return answer


def _send(pipe: IO[bytes] | None, thing: object) -> None:
    assert pipe is not None
    data = pickle.dumps(thing, protocol=5)
    pipe.write(struct.pack("<Q", len(data)))
    pipe.write(data)
    pipe.flush()


def _receive(pipe: IO[bytes] | None) -> Any:
    assert pipe is not None
    head = pipe.read(8)
    if len(head) < 8:
        raise EOFError
    data = pipe.read(struct.unpack("<Q", head)[0])
    return pickle.loads(data)


def _work() -> None:
    """A worker's life: render jobs until the input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # nothing that prints can spoil the answers
    while True:
        try:
            *arguments, options = _receive(sys.stdin.buffer)
        except EOFError:
            return
        try:
            answer: object = render(*arguments, **options)
        except VitruvianError as error:
            answer = error
        _send(answers, answer)


if __name__ == "__main__":
    _work()
