"""Simulated worlds from new seeds, one after another, each in a process of its own."""

from __future__ import annotations

import subprocess
import threading
import time
from random import Random

from tests.soak.processes import spawn

_DAYS = (0.25, 1.0, 1.0, 3.0)
"""The ages of worlds: many young ones find faults of the beginning, a few old ones find growth."""
_HANGS_AFTER = 3600.0
"""s of real time: a simulated day takes about a minute."""


class Worlds:
    """Plays worlds on a thread until told to stop.

    Attributes:
        failures: the output of each failed world, which ends with the command that plays it again.
        played: worlds that have lived to their end.
        days: simulated days of these.
    """

    def __init__(self, random: Random) -> None:
        self.failures: list[str] = []
        self.played = 0
        self.days = 0.0
        self._random = random
        self._began = time.monotonic()
        self._stopping = False
        self._child: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._play, name="worlds", daemon=True)

    @property
    def days_per_hour(self) -> float:
        return self.days / max(time.monotonic() - self._began, 1.0) * 3600

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End, in the middle of a world."""
        self._stopping = True
        if self._child is not None:
            self._child.kill()
        self._thread.join()

    def _play(self) -> None:
        while not self._stopping:
            self._play_one(self._random.randrange(10**9), self._random.choice(_DAYS))

    def _play_one(self, seed: int, days: float) -> None:
        command = ("-m", "tests.simulation", str(seed), "--days", str(days))
        with spawn(command) as self._child:
            try:
                output, _ = self._child.communicate(timeout=_HANGS_AFTER)
            except subprocess.TimeoutExpired:
                self._child.kill()
                output = "it has not ended"
        if self._stopping:
            return
        if code := self._child.returncode:
            self.failures.append(f"{output[-2000:]}\n  it ended with {code}: python {' '.join(command)}")
        else:
            self.played += 1
            self.days += days
