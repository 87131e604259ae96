"""Real programs under attack, for people: ``python -m tests.system.torture [NAME...] [--over TRANSPORT...]``.

Prints a line for each attack and transport. It fails if anything unmeant or old has reached the robot.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

from tests.support.locks import two_domains
from tests.system.torture import demands
from tests.system.torture.attacks import ATTACKS, attack, fits
from tests.system.torture.stage import Nodes

_TRANSPORTS = ("tcp", "udp", "zenoh", "zenoh-drop")
_HEAD = ("attack", "over", "crossed", "old", "after", "unarmed", "oldest", "tolerance")


def main() -> int:
    """Do the attacks."""
    parser = argparse.ArgumentParser(prog="python -m tests.system.torture")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(ATTACKS)}")
    parser.add_argument("--demands", action="store_true", help="instead, see whether a demand can be lost")
    parser.add_argument("--over", nargs="+", choices=_TRANSPORTS, default=_TRANSPORTS)
    arguments = parser.parse_args()
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"XDG_RUNTIME_DIR": folder, "XDG_STATE_HOME": folder, "RSB_CONSOLE_ISOLATED": "1"}
        nodes = Nodes.start(Path(folder), two_domains())
        try:
            if arguments.demands:
                return int(_demands(nodes) > 0)
            _print(*_HEAD)
            for name in arguments.names or ATTACKS:
                for transport in arguments.over:
                    if fits(name, transport):
                        wrong += _case(nodes, name, transport)
        finally:
            nodes.close()
    return int(wrong > 0)


def _case(nodes: Nodes, name: str, transport: str) -> int:
    try:
        found = attack(nodes, name, transport)  # type: ignore[arg-type]
    except AssertionError as error:
        print(f"{name:22}{transport:12}not done: {error}", flush=True)  # noqa: T201
        return 1
    figures = (found.crossed, found.old, found.after, found.unarmed, f"{found.oldest:.2f}", f"{found.tolerance:.2f}")
    _print(name, transport, *figures, "; ".join(found.notes))
    return found.wrong


def _demands(nodes: Nodes) -> int:
    wrong = 0
    for server in ("pc", "robot"):
        for cases in (demands.CASES, demands.EDITS):
            print(f"{f'the {server} is the server':52}{'crossed':>8}{'edited':>8}{'again':>8}  codes")  # noqa: T201
            for name, found in demands.run(nodes, cases, server=server).items():  # type: ignore[arg-type]
                figures = "".join(f"{each:>8}" for each in (found.before, found.after, found.restarted))
                print(f"{name:52}{figures}  {found.codes or ''}", flush=True)  # noqa: T201
                wrong += 0 if name == demands.CONTROL else found.wrong
    return wrong


def _print(name: object, transport: object, *figures: object) -> None:
    print(f"{name:22}{transport:12}" + "".join(f"{each:>10}" for each in figures[:6]), *figures[6:], flush=True)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main())
