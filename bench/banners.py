"""Counts the changes of both screens' banners on a bad path: ``python -m bench.banners`` (as root; it needs tmux).

Two consoles on two hosts (network namespaces) bridge three topics, by TCP each way and by UDP, at 20 Hz. Then the cable
between them loses packets both ways. A line a side has the changes a minute of the lines between the totals and the
table, of these lines without their figures, and the causes they showed.
"""

from __future__ import annotations

import argparse
import os
import re
import tempfile
import time
from collections import Counter
from contextlib import ExitStack, closing
from itertools import pairwise
from pathlib import Path

from tests.console.live import COMMAND
from tests.console.tmux import Tmux
from tests.network.bridging import Sessions
from tests.network.hosts import ROOT, Cable, Host
from tests.network.node import Node

_DOMAINS = (82, 83)
_ADDRESSES = ("10.99.1.2/24", "10.99.1.1/24")
_TOPICS = (
    {"topic": "/odom", "protocol": "tcp"},
    {"topic": "/scan", "protocol": "udp"},
    {"topic": "/cmd", "protocol": "tcp", "direction": "receive"},
)
_RATE, _SIZE = 20, 700
_SCREEN = (140, 40)
_LOOKS = 4
"""Looks at each screen in a second."""
_BEGINS = 20.0
"""s of loss that do not count: the path is found to be lossy in them."""
_FIGURES = re.compile(r"\d+(?:[.,]\d+)*")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loss", type=int, default=30, help="%% of the packets, each way")
    parser.add_argument("--seconds", type=float, default=120.0)
    options = parser.parse_args()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rsb-banners-")))
        os.environ["XDG_STATE_HOME"] = str(folder)
        robot, pc = (stack.enter_context(closing(Host(name))) for name in ("robot", "pc"))
        cable = Cable(robot, pc)
        cable.address(_ADDRESSES)
        cable.single()
        sessions = Sessions(folder, _ADDRESSES[1].partition("/")[0], *_TOPICS, domains=_DOMAINS)
        screens = {}
        for host, session in ((pc, sessions.server), (robot, sessions.client)):
            (folder / host.name).mkdir()
            enter = ("nsenter", "--target", str(host.pid), "--net", "--mount", f"--wdns={ROOT}")
            command = (*enter, str(COMMAND), "run", str(session), "--control", str(session.with_suffix(".sock")))
            screens[host.name] = stack.enter_context(Tmux(folder / host.name, *command, size=_SCREEN))
        nodes = [stack.enter_context(closing(Node(*each))) for each in zip((robot, pc), _DOMAINS, strict=True)]
        nodes[1].listen("/odom", "/scan")
        nodes[0].listen("/cmd")
        for node, topic in ((nodes[0], "/odom"), (nodes[0], "/scan"), (nodes[1], "/cmd")):
            node.talk(topic, rate=_RATE, size=_SIZE)
        for screen in screens.values():
            screen.wait_for("3 ok")
        time.sleep(20)  # the usual rates are learned
        cable.lose(options.loss)
        time.sleep(_BEGINS)
        seen: dict[str, list[str]] = {name: [] for name in screens}
        began = time.monotonic()
        while time.monotonic() - began < options.seconds:
            for name, screen in screens.items():
                seen[name].append(_banner(screen.picture))
            time.sleep(1 / _LOOKS)
        for name, banners in seen.items():
            _report(name, banners, options.seconds / 60)


def _banner(picture: str) -> str:
    """Return the lines between the totals and the table's rule, or all lines if there is no table."""
    lines = picture.splitlines()
    top = next((number for number, line in enumerate(lines) if line.startswith("─")), len(lines))
    return "\n".join(line.rstrip() for line in lines[2:top])


def _report(name: str, banners: list[str], minutes: float) -> None:
    words = [_FIGURES.sub("#", each) for each in banners]
    changes, other_words = (sum(one != other for one, other in pairwise(each)) for each in (banners, words))
    print(f"{name}: {changes / minutes:.1f} changes a minute, {other_words / minutes:.1f} of words")
    for text, count in Counter(words).most_common(8):
        print(f"  {count / len(words):4.0%} of the looks: {' / '.join(text.splitlines()) or 'no line'}")


if __name__ == "__main__":
    main()
