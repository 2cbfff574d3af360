"""The one clock of a stage: counted ticks, so that the same run gives the same times to the bit."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vitruvian.body.types import require


@dataclass
class Clock:
    """Where a play stands.

    `rate`: ticks in a second of the play. `length`: seconds of a round; with `loop` the next round follows it, without
    the clock stops at `last`. `speed`: seconds of the play in a second outside, -4..4. `tick` counts all ticks that were
    made, also those in which time stood still; `dropped` those that were due and not made.
    """

    rate: float = 60.0
    length: float = math.inf
    last: float = math.inf
    loop: bool = True
    speed: float = 1.0
    playing: bool = True
    tick: int = 0
    dropped: int = 0
    _anchor: float = 0.0  # seconds, through all rounds, ...
    _moved: int = 0  # ... and ticks since then
    _owed: float = 0.0  # part of a tick that real time is ahead

    def __post_init__(self) -> None:
        require(0 < self.rate < 1e6, "rate", "ticks per second above zero", self.rate)
        require(self.length > 0, "length", "seconds above zero", self.length)
        self.last = min(self.last, self.length)

    @property
    def total(self) -> float:
        """Seconds of the play through all rounds."""
        return self._anchor + self._moved / self.rate

    @property
    def round(self) -> int:
        """Rounds completed."""
        return 0 if self.length == math.inf else math.floor(self.total / self.length + 1e-12)

    @property
    def time(self) -> float:
        """Seconds within the round."""
        return self.total if self.length == math.inf else max(self.total - self.round * self.length, 0.0)

    def move(self, ticks: int) -> float:
        """Make so many ticks; answers the seconds of play that went by, 0 when paused."""
        self.tick += ticks
        if not self.playing or not ticks:
            return 0.0
        before = self.total
        self._moved += ticks if self.speed >= 0 else -ticks
        first = self.round_at(before) * self.length if self.length < math.inf else 0.0
        if not self.loop and self.total >= first + self.last:
            self._put(first + self.last)
            self.playing = False
        elif self.total < 0 or (not self.loop and self.total < first):
            self._put(max(first, 0.0))
            self.playing = False
        return self.total - before

    def round_at(self, total: float) -> int:
        return math.floor(total / self.length + 1e-12)

    def due(self, elapsed: float) -> int:
        """Ticks that `elapsed` seconds outside ask for; what is less than a tick is kept for the next time."""
        if not self.playing:
            self._owed = 0.0
            return 0
        self._owed += max(elapsed, 0.0) * abs(self.speed) * self.rate
        ticks = math.floor(self._owed + 1e-9)
        self._owed = max(self._owed - ticks, 0.0)
        return ticks

    def seek(self, seconds: float) -> None:
        """Go to a time of this round."""
        start = self.round * self.length if self.length < math.inf else 0.0
        self._put(start + min(max(seconds, 0.0), self.last))

    def play(self) -> None:
        """Let time run; from the start when it had come to its end."""
        if not self.loop and self.time >= self.last - 1 / self.rate:
            self.seek(0.0)
        self.playing = True

    def pace(self, rate: float) -> None:
        """Ticks of another length from here on."""
        if rate != self.rate:
            self._put(self.total)
            self.rate = rate

    def _put(self, total: float) -> None:
        self._anchor, self._moved, self._owed = total, 0, 0.0
