"""Real programs under attack, for people: ``python -m tests.system.torture all``.

Prints a line for each attack and transport: the messages that reached the robot's node, and how many were too old, came
after a side had shown the topic disarmed, or were published while nobody had armed it. Fails unless these are 0.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from tests.support.locks import two_domains
from tests.system.torture import attacks, clock, rests
from tests.system.torture.stage import Nodes

from rsb_bridge.api import EngineError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from tests.system.torture.judge import Findings

_TRANSPORTS = ("tcp", "udp", "zenoh", "zenoh-drop")
_HEAD = ("attack", "over", "crossed", "old", "after", "unarmed", "oldest", "tolerance")
_NOT_DONE = (AssertionError, EngineError, subprocess.TimeoutExpired)


def main() -> int:
    """Do the attacks."""
    parser = argparse.ArgumentParser(prog="python -m tests.system.torture", description=__doc__)
    parser.add_argument("what", choices=("armed", "rests", "all"))
    parser.add_argument("names", nargs="*", metavar="NAME", help="attacks, instead of all")
    parser.add_argument("--by", nargs="+", choices=rests.DRIVERS, default=rests.DRIVERS, help="who drives, for rests")
    parser.add_argument("--over", nargs="+", choices=_TRANSPORTS, default=_TRANSPORTS)
    arguments = parser.parse_args()
    wrong = 0
    steps = {*attacks.STEPS}
    with_steps = clock.POSSIBLE and arguments.what != "rests" and steps & {*(arguments.names or steps)}
    for stepped in (False, True) if with_steps else (False,):
        with tempfile.TemporaryDirectory() as folder:
            os.environ |= {"XDG_RUNTIME_DIR": folder, "XDG_STATE_HOME": folder, "RSB_CONSOLE_ISOLATED": "1"}
            nodes = Nodes.start(Path(folder), two_domains(), stepped=stepped)
            try:
                if arguments.what in ("armed", "all"):
                    wrong += _armed(nodes, arguments)
                if arguments.what in ("rests", "all") and not stepped:
                    wrong += _rests(nodes, arguments)
            finally:
                nodes.close()
    return int(wrong > 0)


def _armed(nodes: Nodes, arguments: argparse.Namespace) -> int:
    every: Iterable[str] = attacks.STEPS if nodes.clocks else attacks.ATTACKS
    _print(*_HEAD)
    wrong = 0
    for name in [each for each in every if each in (arguments.names or every)]:
        for transport in arguments.over:
            if attacks.fits(name, transport):
                wrong += _case(name, transport, lambda: attacks.attack(nodes, name, transport))  # noqa: B023 -- called at once
    return wrong


def _case(name: str, transport: str, run: Callable[[], Findings]) -> int:
    try:
        found = run()
    except _NOT_DONE as error:
        print(f"{name:22}{transport:18}not done: {error}", flush=True)  # noqa: T201
        return 1
    figures = (found.crossed, found.old, found.after, found.unarmed, f"{found.oldest:.2f}", f"{found.tolerance:.2f}")
    in_hand = [f"{found.in_hand} of these were in the bridge's hand in time"] if found.in_hand else []
    _print(name, transport, *figures, "; ".join(in_hand + found.notes))
    return found.wrong


def _rests(nodes: Nodes, arguments: argparse.Namespace) -> int:
    print(f"{'ending':22}{'over':12}{'by':16}{'last':8}{'rest after':>12}{'rests':>7}{'moving late':>13}")  # noqa: T201
    wrong = 0
    for name in [each for each in rests.ENDINGS if each in (arguments.names or rests.ENDINGS)]:
        for transport in [each for each in arguments.over if rests.fits(name, each)]:
            for driver in arguments.by:
                case = f"{name:22}{transport:12}{driver:16}"
                try:
                    found = rests.run(nodes, name, transport, driver)
                except _NOT_DONE as error:
                    print(f"{case}not done: {error}", flush=True)  # noqa: T201
                    wrong += 1
                    continue
                after = "never" if found.after is None else f"{found.after:.2f} s"
                verdict = "  WRONG" if found.wrong else ""
                moving = max(found.moving_after_rest, found.moving_late)
                print(f"{case}{found.last:8}{after:>12}{found.rests:>7}{moving:>13}{verdict}", flush=True)  # noqa: T201
                wrong += found.wrong
    return wrong


def _print(name: object, transport: object, *figures: object) -> None:
    print(f"{name:22}{transport:18}" + "".join(f"{each:>10}" for each in figures[:6]), *figures[6:], flush=True)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main())
