"""Robots that were there, across restarts of the console: so that one that is missing is missed."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import msgspec
from platformdirs import user_state_path

from rsb_bridge.config.files import replace_file
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.text import sanitize_text

if TYPE_CHECKING:
    from pathlib import Path

LIMIT = 1000
"""Robots that are remembered: those that were seen last."""
_FILE_BYTES = 4 << 20


class Remembered(msgspec.Struct, frozen=True):
    """A robot that was there.

    Attributes:
        source: the name of the source that knew it.
        name: the robot's.
        seen: s since the epoch, when it was there last.
        group: as it was then, likewise those below.
        host: likewise.
        version: likewise.
    """

    source: str
    name: str
    seen: float
    group: str = ""
    host: str = ""
    version: str = ""


def memory_path() -> Path:
    return user_state_path("rsb-console") / "fleet.json"


class Memory:
    """The file of robots.

    Args:
        path: the file; None: nothing is kept.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._robots = {(robot.source, robot.name): robot for robot in _read(path)}

    def get(self, source: str, name: str) -> Remembered | None:
        """A robot, if it was there."""
        return self._robots.get((source, name))

    def all(self) -> list[Remembered]:
        """All robots."""
        return list(self._robots.values())

    def of(self, source: str) -> list[Remembered]:
        """All robots of a source."""
        return [robot for robot in self._robots.values() if robot.source == source]

    def saw(self, robot: Remembered) -> None:
        """Remember that a robot is there."""
        self._robots[robot.source, robot.name] = robot
        if len(self._robots) > LIMIT:
            del self._robots[min(self._robots, key=lambda key: self._robots[key].seen)]

    def forget(self, source: str, name: str) -> None:
        """Remember a robot no more."""
        self._robots.pop((source, name), None)

    def save(self) -> None:
        """Write the file; where that cannot be done, the next console knows less."""
        if self._path is not None:
            with contextlib.suppress(OSError):
                self._path.parent.mkdir(parents=True, exist_ok=True)
                replace_file(self._path, msgspec.json.encode(list(self._robots.values())))


def _read(path: Path | None) -> list[Remembered]:
    """What a file has; one that is damaged or too large has nothing."""
    if path is None:
        return []
    try:
        with path.open("rb") as file:
            data = file.read(_FILE_BYTES + 1)
        robots = msgspec.json.decode(data[:_FILE_BYTES], type=list[Remembered])
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return []
    return [_clean(robot) for robot in sorted(robots, key=lambda robot: robot.seen)[-LIMIT:]]


def _clean(robot: Remembered) -> Remembered:
    texts = {
        name: sanitize_text(value, TEXT_LENGTH)
        for name, value in msgspec.structs.asdict(robot).items()
        if isinstance(value, str)
    }
    return msgspec.structs.replace(robot, **texts)
