"""Runs pytest, and once more, alone, what failed: ``net.py COMMAND...`` (tests/README.md, *The net*).

A test that fails and then passes is unstable: the run is green, names it, and writes it to `UNSTABLE`, which CI keeps.
If a process of the tests ends in one of them, that one fails, and what had not been run yet runs with it.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

UNSTABLE = Path("build/unstable.txt")
FAILED = Path(".pytest_cache/v/cache/lastfailed")
MOST = 3
"""Tests that may be unstable in one run: more are no accident."""
LEFT = ("--left",)
ALONE = ("-n", "0", "--last-failed", "--last-failed-no-failures", "none")
_TESTS_FAILED = 1
"""pytest's exit code. Any other is no test's: an interrupt, a time limit, a mistake, nothing to run."""
_WORKER_LOST = 20
"""That of `tests.support.lost_workers`."""


def main(command: list[str]) -> int:
    """Return the exit code: 0 if all tests passed the first time or the second."""
    UNSTABLE.unlink(missing_ok=True)
    code = run(*command, "--cache-clear")  # failures of earlier runs are none of this one's
    first = failures() if code == _WORKER_LOST else []
    if first:
        say("a worker was lost, what is left runs now:", first)
        code = run(*command, *LEFT)
    failed = failures()
    if twice := [each for each in first if each in failed]:
        say("failed twice:", twice)
        return code
    if code not in {0, _TESTS_FAILED} or (code and not failed):
        return code
    unstable = [*first, *failed]
    if len(unstable) > MOST or not all("::" in each for each in unstable):  # else a file whose tests nobody knows
        say(f"not run again: {len(unstable)} failures")
        return _TESTS_FAILED
    if failed:
        say("run once more, alone:", failed)
        if run(*command, *ALONE) or failures():
            say("failed twice:", failures() or failed)
            return code
    if unstable:
        UNSTABLE.parent.mkdir(exist_ok=True)
        UNSTABLE.write_text("".join(f"{each}\n" for each in unstable), encoding="utf-8")
        say("unstable:", unstable)
    return 0


def run(*command: str) -> int:
    with subprocess.Popen(command) as process:
        while True:
            try:
                return process.wait()
            except KeyboardInterrupt:  # from a terminal; `timeout` has a process group of its own
                process.send_signal(signal.SIGINT)


def failures() -> list[str]:
    """Return the tests that failed and have not passed since."""
    return [*json.loads(FAILED.read_text(encoding="utf-8"))] if FAILED.exists() else []


def say(text: str, tests: list[str] | tuple[str, ...] = ()) -> None:
    sys.stdout.write(" ".join((f"\n{text}", *tests)) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
