"""Two bridges, one with recordings, and what an operator asks the other one for."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from tests.support.bridge import linked
from tests.support.relay import Relay
from tests.support.waiting import eventually

from rsb_bridge.feature import MAY
from rsb_bridge.model.session import session_keys
from rsb_extras.courier import RECORDINGS_KEY, RecordingFolders
from rsb_extras.courier.courier_records import LATEST, ListedRecording
from rsb_extras.courier.courier_requests import (
    FetchRecording,
    FetchReport,
    FetchState,
    ListFetches,
    ListRecordings,
    NewestRecordings,
    RecordingGroup,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine


def robot_features(bags: Path, *, may: bool = True) -> dict[str, Any]:
    given = {MAY: session_keys()[MAY].type(recordings=True)} if may else {}
    return {RECORDINGS_KEY.name: RecordingFolders((str(bags),)), **given}


def two_sides(
    bridge: Bridge, bags: Path, *, may: bool = True, own: RecordingFolders | None = None, **others: Any
) -> tuple[Engine, Engine]:
    """Return the control PC, with folders of its own if they are given, and the robot that lets it get recordings."""
    robot = bridge.client(features=robot_features(bags, may=may), **others)
    pc = bridge.server(features={RECORDINGS_KEY.name: own} if own is not None else {})
    eventually(lambda: linked(pc) and linked(robot), what="linked")
    return pc, robot


@contextmanager
def slow_link(bridge: Bridge, rate: float) -> Iterator[Relay]:
    """Have bridges that are made within it be linked by a relay of so many bytes/s."""
    with Relay(("127.0.0.1", bridge.port), rate=rate) as relay:
        bridge.through(relay)
        yield relay


def listed(engine: Engine, link: str = "robot1") -> dict[str, ListedRecording]:
    (group,) = engine.do(ListRecordings(link)).result(60)
    assert not group.problem, group.problem
    return {each.name: each for each in group.recordings}


def newest(engine: Engine, most: int = 8) -> tuple[RecordingGroup, ...]:
    return engine.do(NewestRecordings(most=most)).result(60)


def fetch(engine: Engine, name: str, *topics: str, begin: int = 0, end: int = LATEST) -> str:
    return engine.do(FetchRecording("robot1", name, topics, begin, end)).result(60)


def fetches(engine: Engine) -> tuple[FetchReport, ...]:
    return engine.do(ListFetches()).result(60)


def report(engine: Engine, name: str) -> FetchReport:
    return next(each for each in fetches(engine) if each.name == name)


def done(engine: Engine, name: str) -> FetchReport:
    eventually(lambda: report(engine, name).state in (FetchState.DONE, FetchState.FAILED), 300, f"{name} is over")
    found = report(engine, name)
    assert found.state is FetchState.DONE, found.reason
    return found
