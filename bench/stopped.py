"""Measures how often processes that were stopped hear a node of their machine again: ``python -m bench.stopped``.

Plain nodes publish at 10 Hz, and others subscribe, without a bridge. All listeners are stopped (SIGSTOP) for some
seconds, again and again. A line has those that do not hear a talker 15 s later, as pairs of their numbers, and the port
in shared memory that such a listener has lost. ``--patience`` gives listeners a Fast DDS profile by which senders wait
so many ms before they replace a port whose process stands still.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from bench.bed import NEAR
from tests.support.asked import Asked, answers
from tests.support.domain import Domain, text

from rsb_bridge.ros.memory import PROFILE_VARIABLES
from rsb_bridge.ros.native.shared_memory import ReadPorts

_HEARS_WITHIN = 15.0
_PROFILE = """<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>shm</transport_id><type>SHM</type><healthy_check_timeout_ms>{patience}</healthy_check_timeout_ms>
    </transport_descriptor>
    <transport_descriptor><transport_id>udp</transport_id><type>UDPv4</type></transport_descriptor>
  </transport_descriptors>
  <participant profile_name="patient" is_default_profile="true"><rtps>
    <useBuiltinTransports>false</useBuiltinTransports>
    <userTransports><transport_id>shm</transport_id><transport_id>udp</transport_id></userTransports>
  </rtps></participant>
</profiles>"""


class _End(Asked):
    def __init__(self, what: str, number: int, profile: str = "") -> None:
        variables = dict.fromkeys(PROFILE_VARIABLES, profile) if profile else {}
        self.process = subprocess.Popen(
            (sys.executable, "-m", "bench.stopped", what, str(number)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **variables},
        )
        super().__init__(self.process)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--talkers", type=int, default=5)
    parser.add_argument("--listeners", type=int, default=6)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=2.2, help="that listeners are stopped")
    parser.add_argument("--patience", type=int, default=0, help="ms")
    options = parser.parse_args()
    with contextlib.ExitStack() as stack:
        profile = ""
        if options.patience:
            profile = f"{stack.enter_context(tempfile.TemporaryDirectory())}/profile.xml"
            Path(profile).write_text(_PROFILE.format(patience=options.patience), encoding="utf-8")
        talkers = [_End("talk", number) for number in range(options.talkers)]
        listeners = [_End("listen", options.talkers, profile) for _ in range(options.listeners)]
        for end in (*talkers, *listeners):
            stack.callback(end.close)
        _missing(listeners, 0, 60.0)
        lost: set[tuple[int, int]] = set()
        for _ in range(options.rounds):
            for way in (signal.SIGSTOP, signal.SIGCONT):
                for end in listeners:
                    end.process.send_signal(way)
                time.sleep(options.seconds if way is signal.SIGSTOP else 0.0)
            if new := _missing(listeners, time.time_ns(), _HEARS_WITHIN, lost):
                lost |= new
                ports = {number: listeners[number].ask()["ports"] for number, _ in new}
                print(f"not heard again (listener, talker): {sorted(new)}, ports lost: {ports}", flush=True)
        stops, load = options.rounds * len(listeners), os.getloadavg()[0]
        print(f"{stops} stops, {len({number for number, _ in lost})} listeners deaf, load average {load:.0f}")


def _missing(
    listeners: list[_End], since: int, within: float, known: set[tuple[int, int]] | None = None
) -> set[tuple[int, int]]:
    """Return listeners and talkers without a message published since a time (ns), apart from known ones."""
    deadline = time.monotonic() + within
    while True:
        newest = [end.ask()["newest"] for end in listeners]
        found = {(a, b) for a, times in enumerate(newest) for b, at in enumerate(times) if at <= since}
        found -= known or set()
        if not found or time.monotonic() > deadline:
            return found
        time.sleep(0.2)


def _talk(number: int) -> None:
    publisher, words = Domain(NEAR).publisher(f"/talker_{number}"), text("x" * 300)
    while answers(lambda _: None, 0.1):
        publisher.publish(words)


def _listen(talkers: int) -> None:
    domain = Domain(NEAR)
    ends = [domain.listener(f"/talker_{number}") for number in range(talkers)]
    newest, ports = [0] * talkers, ReadPorts()

    def act(_: dict[str, Any]) -> object:
        return {"newest": newest, "ports": [each.path for each in ports.lost()]}

    while answers(act, 0.05):
        for number, end in enumerate(ends):
            newest[number] = max(newest[number], *end.published, 0)
            end.forget()


if __name__ == "__main__":
    if len(sys.argv) > 2 and sys.argv[1] in {"talk", "listen"}:
        {"talk": _talk, "listen": _listen}[sys.argv[1]](int(sys.argv[2]))
    else:
        main()
