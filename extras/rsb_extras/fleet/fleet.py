"""The robots of all sources, including robots that have gone, remembered across restarts."""

from __future__ import annotations

import contextlib
import difflib
import threading
from collections import deque
from typing import TYPE_CHECKING, Annotated, NamedTuple, Protocol

import msgspec
from platformdirs import user_state_path

from rsb_bridge.feature_api import (
    TEXT_LENGTH,
    RobotState,
    RobotSummary,
    join_first,
    make_folder,
    replace_file,
    sanitize_text,
)
from rsb_bridge.model.limits import TIME
from rsb_bridge.model.names import natural_order
from rsb_bridge.model.robot_summary import drop_repeated_faults

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
    from pathlib import Path

    from rsb_bridge.feature_api import Clock, RemoteEngine

HISTORY = 12
"""Message rates that are kept of each robot, one every `_SAMPLED_EVERY` s: of a minute."""
_SAVED_EVERY = 60.0  # s; a console that is killed forgets so much of when each robot was there. A round figure
_SAMPLED_EVERY = 5.0


class FleetSource(Protocol):
    """A source of robots with unique names. All methods except `start`, `wait` and `open` return at once.

    Attributes:
        kind: kind of the source: ``server`` or ``fleet``.
        name: unique name for operators: ``control``, the server's name.
        way: the options of ``rsb-console fleet`` that lead to it: `` --fleet lab.yaml``, or empty for servers here.
        gone: why a robot is missing that the source has no more.
        empty: what to do if it has no robots.
    """

    kind: str
    name: str
    way: str
    gone: str
    empty: str

    @property
    def problem(self) -> str:
        """The reason why the source has no current data, or an empty string."""

    def start(self) -> None:
        """Connect to the source.

        Raises:
            EngineError: the source cannot be used.
        """

    def wait(self) -> None:
        """Wait at most some seconds for the state of each robot, or the reason for its lack."""

    def stop(self) -> None:
        """Stop the source; `robots` keeps its last result."""

    def robots(self) -> list[RobotSummary]:
        """Return the robots in their present state, including missing ones."""

    def open(self, robot: str, *, read_only: bool) -> RemoteEngine:
        """Open an engine that shows and changes only one robot; the caller stops it.

        It takes some seconds at most.

        Raises:
            EngineError: the engine cannot be opened.
        """


class UnknownRobotError(ValueError):
    """No robot or group has that name; the message lists the existing ones."""


class Robot(NamedTuple):
    """A robot of a fleet.

    Attributes:
        source: source that reports it.
        gone: whether its source no longer has it, so that it is only remembered.
    """

    source: FleetSource
    summary: RobotSummary
    gone: bool = False

    @property
    def key(self) -> str:
        """Unique key among the robots of all sources."""
        return f"{self.source.name}/{self.summary.name}"

    @property
    def is_server(self) -> bool:
        """Whether it is a server's own bridge, for example on a control PC: it has a row, but is no robot."""
        return self.summary.role == "server"

    @property
    def order(self) -> tuple[object, ...]:
        return natural_order(self.summary.name), self.source.name


class RobotFleet:
    """The robots of some sources. `robots`, `chosen` and `dismiss` may be called from any thread.

    Args:
        sources: sources with different names.
        memory: memory of robots that were connected before.
        clock: the wall clock.
    """

    def __init__(self, sources: Sequence[FleetSource], memory: Memory, clock: Clock) -> None:
        self.sources = sources
        self._memory = memory
        self._clock = clock
        self._rates: dict[str, deque[float]] = {}
        self._sampled_at = self._saved_at = float("-inf")
        self._known: set[str] = set()
        self._lock = threading.RLock()

    def start(self) -> None:
        """Start all sources.

        Raises:
            EngineError: one of the sources cannot be used.
        """
        with contextlib.ExitStack() as started:
            for source in self.sources:
                source.start()
                started.callback(source.stop)
            # Until here, an error stops the sources that have started.
            started.pop_all()

    def wait(self) -> None:
        """Wait until the robots have reported their states, for some seconds at most."""
        for source in self.sources:
            source.wait()

    def stop(self) -> None:
        """Stop, and save the known robots for the next start."""
        self._memory.save()
        for source in self.sources:
            source.stop()

    def robots(self) -> list[Robot]:
        """Return all robots in their present state, the worst first, then by name."""
        with self._lock:
            found = [robot for source in self.sources for robot in self._of(source)]
            self._remember(found)
        return sorted(found, key=lambda robot: (robot.summary.state.rank, robot.order))

    def _of(self, source: FleetSource) -> list[Robot]:
        present = [self._with_memory(source, summary) for summary in source.robots()]
        names = {summary.name for summary in present}
        gone = [_gone(each, source) for each in self._memory.of(source.name) if each.name not in names]
        told = drop_repeated_faults([*present, *gone])
        return [Robot(source, summary, gone=number >= len(present)) for number, summary in enumerate(told)]

    def _with_memory(self, source: FleetSource, summary: RobotSummary) -> RobotSummary:
        """Mark a robot that waits for its first connection as missing if it was there before its server began."""
        if summary.state is RobotState.WAITING and not summary.links:
            return summary  # it is there, but has not reported its state yet
        if summary.seen is not None or (before := self._memory.get(source.name, summary.name)) is None:
            return summary
        state = RobotState.MISSING if summary.state is RobotState.WAITING else summary.state
        return msgspec.structs.replace(
            summary,
            state=state,
            seen=before.seen,
            since=before.seen,
            host=summary.host or before.host,
            version=summary.version or before.version,
        )

    def _remember(self, robots: Sequence[Robot]) -> None:
        now = self._clock.time_ns() / 1e9
        # The wall clock may be set back, here and below.
        if sampled := now - self._sampled_at >= _SAMPLED_EVERY or now < self._sampled_at:
            self._sampled_at = now
            self._rates = {robot.key: self._rates.get(robot.key, deque(maxlen=HISTORY)) for robot in robots}
        for robot in robots:
            summary = robot.summary
            if sampled:
                self._rates[robot.key].append(summary.messages_from_robot + summary.messages_to_robot)
            if not robot.gone and summary.seen is not None:
                self._memory.saw(
                    Remembered(
                        robot.source.name,
                        summary.name,
                        summary.seen,
                        summary.group,
                        summary.host,
                        summary.version,
                        summary.role,
                    )
                )
        known = {robot.key for robot in robots}
        if known != self._known or not 0 <= now - self._saved_at < _SAVED_EVERY:
            self._known, self._saved_at = known, now
            self._memory.save()

    def rates(self, robot: Robot) -> Sequence[float]:
        """Return the rates (messages a second, both ways) of each 5 s of the last minute, oldest first."""
        return tuple(self._rates.get(robot.key, ()))

    def dismiss(self, robots: Iterable[Robot]) -> None:
        """Forget the robots among these that have gone."""
        with self._lock:
            for robot in robots:
                if robot.gone:
                    self._memory.forget(robot.source.name, robot.summary.name)
            self._memory.save()

    def chosen(
        self, names: Collection[str], group: str = "", *, everyone: bool = False, gone: bool = False
    ) -> list[Robot]:
        """Return the robots that are named or in a group, sorted by name.

        Args:
            names: an operator's names: ``robot1``, or ``control/robot1`` with the source if several have one.
            group: name of a group whose robots to include, or empty.
            everyone: include all robots. Servers are no robots, and are included by name only.
            gone: choose from the robots that have gone instead of the present ones.

        Raises:
            UnknownRobotError: a robot is not there, or its name is ambiguous.
        """
        robots = sorted((robot for robot in self.robots() if robot.gone is gone), key=lambda robot: robot.order)
        found: dict[str, Robot] = {}
        for robot in robots:
            # A server on Zenoh is listed, but is no robot. One that has gone is to be forgotten with the others.
            if (gone or not robot.is_server) and (everyone or (group and robot.summary.group == group)):
                found[robot.key] = robot
        if group and not any(robot.summary.group == group for robot in robots):
            groups = sorted({robot.summary.group for robot in robots} - {""})
            raise UnknownRobotError(f"no robot is in a group {group!r}; groups: {', '.join(groups) or 'none'}")
        for name in names:
            meant = [robot for robot in robots if name in (robot.summary.name, robot.key)]
            if not meant:
                if not gone and any(robot.gone and name in (robot.summary.name, robot.key) for robot in self.robots()):
                    raise UnknownRobotError(f"{name} is not connected now")
                what = "robot that has gone" if gone else "robot"
                raise UnknownRobotError(_unknown(what, name, [robot.summary.name for robot in robots]))
            if len(meant) > 1:
                keys = ", ".join(robot.key for robot in meant)
                raise UnknownRobotError(f"several robots are named {name}; choose one: {keys}")
            found[meant[0].key] = meant[0]
        return sorted(found.values(), key=lambda robot: robot.order)


def _gone(robot: Remembered, source: FleetSource) -> RobotSummary:
    return RobotSummary(
        name=robot.name,
        group=robot.group,
        role=robot.role,
        state=RobotState.MISSING,
        why=source.gone,
        since=robot.seen,
        seen=robot.seen,
        host=robot.host,
        version=robot.version,
    )


def _unknown(what: str, name: str, known: Sequence[str]) -> str:
    if near := difflib.get_close_matches(name, known, n=1):
        return f"no {what} is named {name}; did you mean {near[0]}?"
    return f"no {what} is named {name}; there are {join_first(known, 10) or 'none'}"


LIMIT = 1000
"""Most robots to remember: the latest ones."""
_FILE_BYTES = 4 << 20  # thrice what 1,000 robots with the longest texts take in ASCII; more is not read into memory


class Remembered(msgspec.Struct, frozen=True):
    """A robot that was connected before.

    Attributes:
        source: name of the source that reported it.
        seen: time when it was last connected, s since the epoch.
        group: its group at that time.
        host: its host at that time.
        version: its version at that time.
        role: ``server`` of a server's own bridge.
    """

    source: str
    name: str
    # An infinite time would be written as null, and the file could not be read again.
    seen: Annotated[float, msgspec.Meta(ge=TIME.low, le=TIME.high)]
    group: str = ""
    host: str = ""
    version: str = ""
    role: str = ""


def memory_path() -> Path:
    return user_state_path("rsb-console") / "fleet.json"


class Memory:
    """The file of remembered robots, which several consoles may have open.

    Args:
        path: path of the file, or None to keep nothing.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._robots = _newest(_read(path))
        self._changed: set[tuple[str, str]] = set()  # since the last save

    def get(self, source: str, name: str) -> Remembered | None:
        """Return a remembered robot, or None."""
        return self._robots.get((source, name))

    def all(self) -> list[Remembered]:
        return list(self._robots.values())

    def of(self, source: str) -> list[Remembered]:
        return [robot for robot in self._robots.values() if robot.source == source]

    def saw(self, robot: Remembered) -> None:
        """Remember that a robot is there."""
        self._robots[robot.source, robot.name] = robot
        self._changed.add((robot.source, robot.name))
        if len(self._robots) > LIMIT:
            del self._robots[min(self._robots, key=lambda key: self._robots[key].seen)]

    def forget(self, source: str, name: str) -> None:
        self._robots.pop((source, name), None)
        self._changed.add((source, name))

    def save(self) -> None:
        """Write the file; ignore errors, as only the next console's memory depends on it.

        Another console may have seen and dismissed others meanwhile, so only what has changed here is changed there.
        """
        if self._path is None:
            return
        with contextlib.suppress(OSError):
            make_folder(self._path.parent)
            others = {key: robot for key, robot in _newest(_read(self._path)).items() if key not in self._changed}
            own = {key: robot for key, robot in self._robots.items() if key in self._changed}
            robots = _newest((others | own).values())
            replace_file(self._path, msgspec.json.encode(list(robots.values())))
            self._robots = robots
            self._changed.clear()


def _newest(robots: Iterable[Remembered]) -> dict[tuple[str, str], Remembered]:
    """Return the latest robots by source and name, as many as may be remembered."""
    return {(robot.source, robot.name): robot for robot in sorted(robots, key=lambda robot: robot.seen)[-LIMIT:]}


def _read(path: Path | None) -> list[Remembered]:
    """Return the contents of a file, or nothing if it is damaged or too large."""
    if path is None:
        return []
    try:
        with path.open("rb") as file:
            robots = msgspec.json.decode(file.read(_FILE_BYTES), type=list[Remembered])
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return []
    return [*map(_clean, robots)]


def _clean(robot: Remembered) -> Remembered:
    texts = {
        name: sanitize_text(value, TEXT_LENGTH)
        for name, value in msgspec.structs.asdict(robot).items()
        if isinstance(value, str)
    }
    return msgspec.structs.replace(robot, **texts)
