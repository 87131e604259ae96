"""Simulated worlds from new seeds, one after another, each in a process of its own.

``python -m tests.soak.worlds SEED DAYS`` plays one, and says every second how far it is.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import Counter
from typing import TYPE_CHECKING, Any

from tests.soak.processes import spawn

if TYPE_CHECKING:
    import subprocess
    from random import Random

_DAYS = (0.25, 1.0, 1.0, 3.0)
"""The ages of worlds: many young ones find faults of the beginning, a few old ones find growth."""
_SILENT_FOR = 300.0
_DAY = 86_400.0


class Worlds:
    """Plays worlds on a thread until told to stop.

    Attributes:
        failures: of each failed world, the violation and the command that plays it again.
        played: worlds that have lived to their end.
    """

    def __init__(self, random: Random) -> None:
        self.failures: list[str] = []
        self.played = 0
        self._random = random
        self._days = 0.0
        self._faults: Counter[str] = Counter()
        self._current: dict[str, Any] = {}
        self._began = time.monotonic()
        self._seconds = 0.0
        self._stopping = False
        self._child: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._play, name="worlds", daemon=True)

    @property
    def days(self) -> float:
        """Simulated days played, including those of a running world."""
        return self._days + float(self._current.get("days", 0.0))

    @property
    def faults(self) -> Counter[str]:
        """Faults and operators' commands in them, by kind."""
        return self._faults + Counter(self._current.get("faults", {}))

    @property
    def days_per_hour(self) -> float:
        """Simulated days in an hour of real time."""
        return self.days / max(self._seconds or time.monotonic() - self._began, 1.0) * 3600

    def start(self) -> None:
        """Begin."""
        self._began = time.monotonic()
        self._thread.start()

    def stop(self) -> None:
        """End, in the middle of a world."""
        self._seconds = time.monotonic() - self._began
        self._stopping = True
        if self._child is not None:
            self._child.kill()
        self._thread.join()

    def _play(self) -> None:
        while not self._stopping:
            self._play_one(self._random.randrange(10**9), self._random.choice(_DAYS))

    def _play_one(self, seed: int, days: float) -> None:
        self._child = child = spawn(("-m", "tests.soak.worlds", str(seed), str(days)))
        assert child.stdout is not None
        assert child.stdin is not None
        watchdog, strays = threading.Timer(_SILENT_FOR, child.kill), []
        watchdog.start()
        for line in child.stdout:
            watchdog.cancel()
            watchdog = threading.Timer(_SILENT_FOR, child.kill)
            watchdog.start()
            if line.startswith('{"days"'):
                self._current = json.loads(line)
            else:
                strays.append(line)
        watchdog.cancel()
        code = child.wait()
        child.stdin.close()
        child.stdout.close()
        if self._stopping:
            return
        self._days += float(self._current.get("days", 0.0))
        self._faults.update(self._current.get("faults", {}))
        if code:
            played = float(self._current.get("days", 0.0))
            failed = self._current.get("failed") or f"it ended with {code}: {''.join(strays)[-2000:]}"
            again = (
                self._current.get("again") or f"python -m tests.simulation {seed} --days {min(days, played + 0.1):.3f}"
            )
            self.failures.append(f"{failed}\n  play it again: {again}")
        else:
            self.played += 1
        self._current = {}


def main(seed: int, days: float) -> int:
    """Play one world, and say how far it is."""
    from tests.simulation.world import Violation, World

    world = World(seed)
    over = threading.Event()

    def tell(**more: str) -> None:
        line = json.dumps({"days": world.loop.time() / _DAY, "faults": dict(world.log.faults)} | more)
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()

    def watch() -> None:
        while not over.wait(1.0):
            tell()

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    failure: Violation | None = None
    try:
        world.play(days * _DAY)
    except Violation as violation:
        failure = violation
    over.set()
    watching.join()
    if failure is not None:
        tell(failed=str(failure), again=world.command())
        return 1
    tell()
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), float(sys.argv[2])))
