"""A fleet on this machine: one control side with real ROS, and robots whose ROS is a stand-in (`bench.robots`)."""

from __future__ import annotations

import contextlib
import itertools
import signal
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.cdr.known_types import BATTERY_STATE, STRING
from rsb_bridge.config import session_file
from rsb_bridge.config.file_form import as_said, with_types
from rsb_bridge.config.keys import write_key
from rsb_bridge.feature_api import Client, Session, Topic
from rsb_bridge.model.session import Operator, session_keys
from rsb_extras.demo import processes
from rsb_extras.demo.demo_session import free_port
from rsb_extras.demo.processes import READY_WITHIN, Process, ProcessError
from rsb_extras.demo.stand_in import Talk
from rsb_extras.fleet.robots import RobotRecord, RobotRecords, RobotTraffic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

ROBOTS = "rsb_extras.fleet.robots"
USUAL = RobotTraffic((Talk("/pose", 10.0, 200), Talk("/status", 1.0, 200), Talk("/scan", 5.0, 2500)), ("/goal",))
WITH_BATTERY = RobotTraffic((*USUAL.talks, Talk("/battery_state", 1.0, 0, BATTERY_STATE)), USUAL.hears)
MOST_IN_ONE = 50
"""Most robots in one process, whose threads share an interpreter. A round figure."""
_OPERATOR, _OPERATOR_KEY = "operator", "operator.key"
_HOST = "127.0.0.1"
_LOOK_EVERY = 0.25  # s. A round figure: each look asks all processes


@contextlib.contextmanager
def tcp() -> Iterator[tuple[dict[str, Any], None]]:
    """Robots connect to the control side."""
    yield {"server_ip": _HOST, "server_port": free_port()}, None


@contextlib.contextmanager
def zenoh() -> Iterator[tuple[dict[str, Any], Process]]:
    """Robots and the control side connect to a router."""
    endpoint = f"tcp/{_HOST}:{free_port()}"
    with processes.router(endpoint) as router:
        yield {"server_ip": "zenoh", "features": {"zenoh": {"connect": [endpoint], "fleet": "simulated"}}}, router


WAYS: dict[str, Callable[[], AbstractContextManager[tuple[dict[str, Any], Process | None]]]] = {
    "tcp": tcp, "zenoh": zenoh,
}  # fmt: skip
"""Networks of the links by name. Each starts the router that it may need, and gives the fields of all sessions, too."""


@dataclass(slots=True)
class SimulatedFleet:
    """A running fleet.

    Attributes:
        folder: folder of all files.
        names: names of the robots.
        load: traffic of each robot.
        session: the control side's session file.
        processes: processes of the robots.
        control: the control side's process.
        router: router of the links, or None.
        file: fleet file by which an operator's console reaches all engines over Zenoh, or None without operators.
    """

    folder: Path
    names: Sequence[str]
    load: RobotTraffic
    session: Path
    router: Process | None = None
    file: Path | None = None
    processes: list[Process] = field(default_factory=list)
    control: Process | None = None
    _in: dict[str, Process] = field(default_factory=dict)

    @property
    def socket(self) -> Path:
        return self.session.with_suffix(".sock")

    def start_control(self) -> Process:
        folder = self.folder
        apart = {"XDG_RUNTIME_DIR": str(folder), "XDG_STATE_HOME": str(folder)}
        arguments = ("--no-ui", "--control", str(self.socket), str(self.session))
        self.control = Process("-m", "rsb_console", "run", *arguments, log=folder / "control.log", environ=apart)
        return self.control

    def start_robots(self, names: Sequence[str]) -> None:
        """Start robots, at most `MOST_IN_ONE` in a process."""
        load = msgspec.json.encode(self.load).decode()
        for first in range(0, len(names), MOST_IN_ONE):
            some = names[first : first + MOST_IN_ONE]
            process = Process("-m", ROBOTS, load, *(str(self.folder / f"{name}.yaml") for name in some))
            self.processes.append(process)
            self._in |= dict.fromkeys(some, process)

    def tell(self, name: str, command: str, *words: str) -> None:
        """Send a command to a robot (`bench.robots`)."""
        self._in[name].ask(" ".join((command, name, *words)))

    def records(self) -> dict[str, RobotRecord]:
        """Return the record of each robot."""
        # All are asked before the first one has answered, so that they work at the same time.
        for process in self.processes:
            process.tell("look")
        found: dict[str, RobotRecord] = {}
        for process in self.processes:
            answer = process.line()
            if not answer:
                raise ProcessError("a process of robots has ended by itself")
            found |= msgspec.json.decode(answer, type=RobotRecords).robots
        return found

    def wait(self, done: Callable[[RobotRecord], bool], within: float) -> dict[str, RobotRecord]:
        """Wait until something is true of each robot.

        Raises:
            ProcessError: it is not true of every robot in time.
        """
        deadline = time.monotonic() + within
        while True:
            robots = self.records()
            late = [name for name, robot in robots.items() if not done(robot)]
            if not late:
                return robots
            if time.monotonic() > deadline:
                raise ProcessError(
                    f"{len(late)} of {len(robots)} robots are not ready within {within:.0f} s: {late[0]}"
                )
            time.sleep(_LOOK_EVERY)

    def stop(self) -> None:
        processes = [*self.processes, *filter(None, [self.control])]
        # All get the signal first, since each may take seconds to end.
        for process in processes:
            process.signal(signal.SIGTERM)
        for process in processes:
            process.stop()


@contextlib.contextmanager
def fleet(
    folder: Path,
    names: Sequence[str],
    *,
    domain: int,
    over: str = "tcp",
    load: RobotTraffic = USUAL,
    groups: Sequence[str] = (),
    operated: bool = False,
) -> Iterator[SimulatedFleet]:
    """Write the sessions and keys of a fleet; on exit, end all processes that were started.

    Args:
        domain: the control side's domain.
        over: network of the links, one of `WAYS`.
        groups: groups to assign to the robots in turn, or empty.
        operated: whether each engine accepts an operator over Zenoh.
    """
    group_of = dict(zip(names, itertools.cycle(groups), strict=False)) if groups else {}
    topics = (
        *(Topic(topic=talk.topic, direction="transmit", type=talk.type) for talk in load.talks),
        *(Topic(topic=topic, direction="receive", type=STRING) for topic in load.hears),
    )
    with WAYS[over]() as (common, router):
        network: dict[str, Any] = common.pop("features", {})
        if operated:
            write_key(folder / _OPERATOR_KEY)
            common["operators"] = (Operator(_OPERATOR, _OPERATOR_KEY, "change"),)
        for name in names:
            write_key(folder / f"{name}.key")
            session = Session(
                name=name,
                role="client",
                domain_id=0,
                key_file=f"{name}.key",
                shutdown_topic=None,
                features=network | as_said({name: None for name, key in session_keys().items() if key.own_topic}),
                topics=topics,
                group=group_of.get(name),
                **common,
            )
            session_file.save(with_types(session), folder / f"{name}.yaml")
        clients = tuple(Client(name, key_file=f"{name}.key", group=group_of.get(name)) for name in names)
        path = folder / "control.yaml"
        control_side = Session(
            name="control", role="server", domain_id=domain, use_name=True, clients=clients, features=network, **common
        )
        session_file.save(with_types(control_side), path)
        file = _operators_file(folder, network) if operated else None
        running = SimulatedFleet(folder, names, load, path, router, file)
        try:
            yield running
        finally:
            running.stop()


def _operators_file(folder: Path, network: dict[str, Any]) -> Path:
    """Write the fleet file of an operator's console; JSON is valid YAML."""
    path = folder / "fleet.yaml"
    path.write_bytes(msgspec.json.encode(network | {"operator": _OPERATOR, "key_file": _OPERATOR_KEY}))
    return path


def listening(process: Process, session: Path) -> float:
    """Wait until the control side's server listens; return the last time (s since the epoch) at which it did not."""
    if port := session_file.load(session).server_port:
        monotonic = processes.listening(process, port)
        return time.time() - (time.monotonic() - monotonic)
    deadline, before = time.monotonic() + READY_WITHIN, time.time()
    while "listening on" not in (session.parent / "control.log").read_text(encoding="utf-8"):
        if time.monotonic() > deadline or not process.running:
            raise ProcessError("the server does not start")
        time.sleep(0.01)
        before = time.time()
    return before
