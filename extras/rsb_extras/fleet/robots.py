"""Robots in one process, each with its own bridge: ``python -m rsb_extras.fleet.robots LOAD SESSION...``.

LOAD is the JSON of a `RobotTraffic`. The bridges are the real ones, over real sockets; their ROS is a stand-in
(`rsb_extras.demo.stand_in`). A bridge with operators in its session is served on the socket ``NAME.sock`` in its file's
folder. The process takes commands as lines, answers with lines of JSON, and ends with its standard input:

- ``look`` answers with a `RobotRecords`.
- ``stop NAME`` stops a robot's bridge and ``start NAME`` starts it again. ``mute NAME TOPIC`` makes its node stop
  publishing a topic, and ``flood NAME TOPIC SIZE`` makes it publish as fast as the bridge takes the messages.
"""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.control.bridges import serve
from rsb_bridge.feature_api import Engine, EventCode, load
from rsb_extras.demo.stand_in import Metronome, StandIn, Talk

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.feature_api import ControlServer

_ATTEMPTS = (EventCode.LINK_UNREACHABLE, EventCode.LINK_REFUSED)


class RobotTraffic(msgspec.Struct, frozen=True):
    """The traffic of each robot's node.

    Attributes:
        talks: topics that it publishes.
        hears: topics that it subscribes to.
    """

    talks: tuple[Talk, ...]
    hears: tuple[str, ...]

    @property
    def routes(self) -> int:
        return len(self.talks) + len(self.hears)


class RobotRecord(msgspec.Struct):
    """The record of one robot's bridge. Times are s since the epoch.

    Attributes:
        attempts: times of failed attempts to link.
        refused: number of attempts that the server refused.
        up: times when it was linked.
        open: times when a route was opened.
        published: number of messages that its node has published.
    """

    attempts: list[float] = []
    refused: int = 0
    up: list[float] = []
    open: list[float] = []
    published: int = 0


class RobotRecords(msgspec.Struct):
    """The robots of a process, by name."""

    robots: dict[str, RobotRecord]


class _Bridged:
    def __init__(self, path: Path, load_: RobotTraffic) -> None:
        self._path = path
        self._session = load(path)
        self.name = self._session.name
        self.ros = StandIn(self.name, load_.talks, load_.hears)
        self._robot = RobotRecord()
        self._engine: Engine | None = None
        self._server: ControlServer | None = None
        self._followed = 0
        self._changing = threading.Lock()

    def start(self) -> None:
        with self._changing:
            if self._engine is None:
                self._engine, self._followed = Engine(self._session, base=self._path.parent, ros=self.ros), 0
                if self._session.operators:
                    self._server = serve(
                        self._engine,
                        self._session,
                        file=self._path,
                        control=self._path.with_suffix(".sock"),
                        on_stop=self._stop_soon,
                    )
                self._engine.start()

    def stop(self) -> None:
        with self._changing:
            if self._engine is not None:
                self._engine.stop()
                self._follow()
                self._engine = None
            if self._server is not None:
                self._server.close()
                self._server = None

    def _stop_soon(self) -> None:
        """End the process of a robot that has its own."""
        # This runs on the server's thread, whose end `stop` waits for.
        threading.Thread(target=self.stop, daemon=True).start()

    def record(self) -> RobotRecord:
        self._follow()
        self._robot.published = sum(self.ros.published.values())
        return self._robot

    def _follow(self) -> None:
        for event in self._engine.events(self._followed) if self._engine is not None else ():
            self._followed = event.number
            if event.code in _ATTEMPTS:
                self._robot.attempts.append(event.time)
                self._robot.refused += event.code == EventCode.LINK_REFUSED
            elif event.code == EventCode.LINK_UP:
                self._robot.up.append(event.time)
            elif event.code == EventCode.ROUTE_CONNECTED:
                self._robot.open.append(event.time)


def main(arguments: Sequence[str]) -> None:
    load_ = msgspec.json.decode(arguments[0], type=RobotTraffic)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    robots = {robot.name: robot for robot in (_Bridged(Path(path), load_) for path in arguments[1:])}
    metronome = Metronome(Random())  # noqa: S311 -- phases, no secret
    for robot in robots.values():
        robot.start()
        metronome.add(robot.ros)
    for line in sys.stdin:
        answer = _carry_out(line.split(), robots, metronome)
        sys.stdout.buffer.write(msgspec.json.encode(answer) + b"\n")
        sys.stdout.buffer.flush()
    # The robots vanish with the process, as if all were switched off: their threads are daemons.


def _carry_out(words: Sequence[str], robots: dict[str, _Bridged], metronome: Metronome) -> RobotRecords:
    match words:
        case ["start", name]:
            robots[name].start()
        case ["stop", name]:
            robots[name].stop()
        case ["mute", name, topic]:
            robots[name].ros.muted.add(topic)
        case ["flood", name, topic, size]:
            metronome.flood(robots[name].ros, Talk(topic, 0.0, int(size)))
        case _:
            return RobotRecords({name: robot.record() for name, robot in robots.items()})
    return RobotRecords({})


if __name__ == "__main__":
    main(sys.argv[1:])
