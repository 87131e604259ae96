"""Demands that something be armed, by entries and patterns of either side, and edits that might lose them.

Nobody arms anything here, so nothing may cross, except what no session wants armed.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tests.system.torture.stage import Stage

from rsb_bridge.model.session import Session

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from tests.system.torture.stage import Nodes, Side

RATE = 10.0
CONTROL = "/control/cmd"
"""No session wants it armed: it has to cross, or the others prove nothing."""

_STARTS_WITHIN = 60.0
_WATCHED = 4.0
_EDITS_AT_ONCE = 4


def _entry(topic: str, arm: bool = False, **keys: Any) -> dict[str, Any]:
    return {"topic": topic, "direction": "receive", **({"arm": True} if arm else {}), **keys}


@dataclass(frozen=True)
class Case:
    """Names and sessions; ``@`` is replaced by a folder that no other case uses.

    Attributes:
        robot: entries of the robot's session.
        pc: entries of the control PC's session, in its client's entry.
        published: names in the control PC's domain.
        heard: names in the robot's domain.
        armed: names and patterns that a side's session keeps armed without an entry.
        steps: commands on running bridges: side, command, arguments.
    """

    name: str
    robot: Sequence[dict[str, Any]] = ()
    pc: Sequence[dict[str, Any]] = ()
    published: tuple[str, ...] = ("@/cmd",)
    heard: tuple[str, ...] = ("@/cmd",)
    armed: tuple[tuple[Side, str], ...] = ()
    steps: tuple[tuple[Side, str, tuple[str, ...]], ...] = ()


_BACK = {"direction": "transmit"}
_NAME, _ARMED = _entry("@/cmd"), _entry("@/cmd", arm=True)
_ALL, _ALL_ARMED = _entry("@/*"), _entry("@/*", arm=True)
_LIKE_ARMED = _entry("@/cm*", arm=True)

CASES = (
    Case("robot's entry", [_ARMED]),
    Case("pc's entry, robot lists it without", [_NAME], [_ARMED]),
    Case("pc's entry, robot's pattern without", [_ALL], [_ARMED]),
    Case("robot's entry, pc lists it without", [_ARMED], [_NAME]),
    Case("pc's pattern, robot lists it without", [_NAME], [_ALL_ARMED]),
    Case("robot's pattern, pc lists it without", [_ALL_ARMED], [_NAME]),
    Case("robot's pattern, robot lists it without", [_NAME, _ALL_ARMED]),
    Case("pc's pattern, pc lists it without", [], [_NAME, _ALL_ARMED]),
    Case("robot's earlier pattern without", [_ALL, _LIKE_ARMED]),
    Case("pc's earlier pattern without", [], [_ALL, _LIKE_ARMED]),
    Case("robot's later pattern without", [_LIKE_ARMED, _ALL]),
    Case("pc's pattern, robot's pattern without", [_ALL], [_LIKE_ARMED]),
    Case("robot's pattern, pc's pattern without", [_LIKE_ARMED], [_ALL]),
    Case("robot's pattern of the other direction", [_NAME, _ALL_ARMED | _BACK]),
    Case("pc's pattern of the other direction", [_NAME], [_ALL_ARMED | _BACK]),
    Case("pc's entry of the other direction", [_NAME], [_ARMED | _BACK]),
    Case("robot's `armed`", [_NAME], armed=(("robot", "@/cmd"),)),
    Case("pc's `armed`", [_NAME], armed=(("pc", "@/cmd"),)),
    Case("pc's `armed` pattern", [_ALL], armed=(("pc", "@/*"),)),
    Case(
        "pc's name, a second route by another name",
        [_entry("@/other", remote_topic="@/cmd")],
        [_ARMED],
        heard=("@/cmd", "@/other"),
    ),
    Case(
        "robot's name, a second route into it",
        [_ARMED],
        [_entry("@/cmd", remote_topic="@/way2")],
        published=("@/cmd", "@/way2"),
    ),
    Case(
        "robot's pattern, pc sends by another name",
        [_ALL_ARMED],
        [_entry("@/cmd", remote_topic="@far/cmd")],
        published=("@far/cmd",),
    ),
)

EDITS = (
    Case("edit on the pc", [_NAME], [_ARMED], steps=(("pc", "edit", ("@/cmd", "compression=zstd")),)),
    Case("edit on the robot", [_NAME], [_ARMED], steps=(("robot", "edit", ("@/cmd", "compression=zstd")),)),
    Case("edit of the robot's own", [_ARMED], steps=(("robot", "edit", ("@/cmd", "compression=zstd")),)),
    Case("edit of the robot's own on the pc", [_ARMED], steps=(("pc", "edit", ("@/cmd", "compression=zstd")),)),
    Case("remove on the pc", [_NAME], [_ARMED], steps=(("pc", "remove", ("@/cmd",)),)),
    Case("remove on the robot", [_NAME], [_ARMED], steps=(("robot", "remove", ("@/cmd",)),)),
    Case(
        "remove and add on the robot",
        [_ARMED],
        steps=(("robot", "remove", ("@/cmd",)), ("robot", "add", ("@/cmd", "receive"))),
    ),
    Case(
        "remove and add on the pc",
        [],
        [_ARMED],
        steps=(("pc", "remove", ("@/cmd",)), ("pc", "add", ("@/cmd", "receive"))),
    ),
    Case("edit of what the pc's pattern brings", [], [_ALL_ARMED], steps=(("pc", "edit", ("@/cmd", "max_rate=50")),)),
    Case(
        "edit on the robot of what the pc's pattern brings",
        [],
        [_ALL_ARMED],
        steps=(("robot", "edit", ("@/cmd", "max_rate=50")),),
    ),
    Case("edit of what the robot's pattern brings", [_ALL_ARMED], steps=(("robot", "edit", ("@/cmd", "max_rate=50")),)),
    Case(
        "remove what the pc's pattern brings, add",
        [],
        [_ALL_ARMED],
        steps=(("pc", "remove", ("@/cmd",)), ("robot", "add", ("@/cmd", "receive"))),
    ),
    Case(
        "remove the pc's pattern, add on the robot",
        [],
        [_ALL_ARMED],
        steps=(("pc", "remove", ("@/*",)), ("robot", "add", ("@/cmd", "receive"))),
    ),
    Case(
        "add a second route on the pc",
        [_ARMED],
        heard=("@/cmd", "@/second"),
        steps=(("pc", "add", ("@/second", "receive", "remote_topic=@/cmd")),),
    ),
    Case(
        "add a second route on the robot",
        [_NAME],
        [_ARMED],
        heard=("@/cmd", "@/second"),
        steps=(("robot", "add", ("@/second", "receive", "remote_topic=@/cmd")),),
    ),
    Case(
        "except in the pc's pattern, add on the robot",
        [],
        [_ALL_ARMED],
        steps=(("pc", "edit", ("@/*", "except=@/cmd")), ("robot", "add", ("@/cmd", "receive"))),
    ),
    Case(
        "except in the robot's pattern, add on the pc",
        [_ALL_ARMED],
        steps=(("robot", "edit", ("@/*", "except=@/cmd")), ("pc", "add", ("@/cmd", "receive"))),
    ),
    Case(
        "arm=false on the robot, whose session does not demand it",
        [_NAME],
        [_ARMED],
        steps=(("robot", "edit", ("@/cmd", "arm=false")),),
    ),
    Case(
        "arm=false on the pc, whose session does not demand it",
        [_ARMED],
        [_NAME],
        steps=(("pc", "edit", ("@/cmd", "arm=false")),),
    ),
    Case(
        "arm=false for another name of the pc's pattern",
        [_NAME, _entry("@/cmd2")],
        [_ALL_ARMED],
        published=("@/cmd", "@/cmd2"),
        steps=(("pc", "edit", ("@/cmd2", "arm=false")),),
    ),
    Case(
        "another name on the pc",
        [_ARMED],
        published=("@/cmd", "@/cmd2"),
        steps=(("robot", "edit", ("@/cmd", "remote_topic=@/cmd2")),),
    ),
    Case(
        "another name on the pc, and back",
        [_NAME],
        [_ARMED],
        steps=(
            ("pc", "edit", ("@/cmd", "remote_topic=@/cmd2")),
            ("robot", "edit", ("@/cmd", "remote_topic=@/cmd2")),
            ("robot", "edit", ("@/cmd", "remote_topic=@/cmd")),
        ),
    ),
    Case(
        "edit twice on the pc",
        [_NAME],
        [_ARMED],
        steps=(
            ("pc", "edit", ("@/cmd", "compression=zstd")),
            ("pc", "edit", ("@/cmd", "max_rate=50")),
            ("pc", "remove", ("@/cmd",)),
            ("pc", "add", ("@/cmd", "receive")),
            ("pc", "remove", ("@/cmd",)),
        ),
    ),
    Case(
        "the robot removes the pc's pattern's topic, adds a pattern",
        [],
        [_ALL_ARMED],
        steps=(("robot", "remove", ("@/cmd",)), ("robot", "add", ("@/*", "receive"))),
    ),
    Case(
        "pause and resume on the pc",
        [_NAME],
        [_ARMED],
        steps=(("pc", "pause", ("@/cmd",)), ("pc", "resume", ("@/cmd",))),
    ),
)

_ARMED_KEY = "keep_armed" if "keep_armed" in Session.__struct_fields__ else "armed"


def known(case: Case) -> bool:
    """Whether this version knows all keys of a case."""
    return _ARMED_KEY in Session.__struct_fields__ or not case.armed


@dataclass
class Crossed:
    """The figures of a case.

    Attributes:
        before: messages that reached the robot before any command.
        after: since the first command.
        restarted: since the robot's bridge was started again.
        codes: exit codes of the commands.
    """

    before: int = 0
    after: int = 0
    restarted: int = 0
    codes: tuple[int, ...] = ()

    @property
    def wrong(self) -> int:
        """How many messages should not have reached the robot."""
        return self.before + self.after + self.restarted


def run(nodes: Nodes, cases: Iterable[Case], *, server: Side = "pc", watched: float = _WATCHED) -> dict[str, Crossed]:
    """Run all cases in one bridge, and return the figures of each and of `CONTROL`, by name.

    Args:
        cases: each in a folder of its own.
        server: the side that listens for the other one.
        watched: s in which nothing may cross, three times, not counting the time until `CONTROL` does.
    """
    places = {f"/case{number}": case for number, case in enumerate(cases) if known(case)}
    control = Case(CONTROL, [_entry("@/cmd")])
    places["/control"] = control
    found = {case.name: Crossed() for case in places.values()}
    heard = {name.replace("@", place): case.name for place, case in places.items() for name in case.heard}
    published = [name.replace("@", place) for place, case in places.items() for name in case.published]
    with Stage(nodes, server=server, entries=_sessions(places, server)) as stage:
        nodes.ear.listen(heard)
        nodes.talker.talk(published, RATE)

        def count() -> dict[str, int]:
            counts = dict.fromkeys(found, 0)
            for each in nodes.ear.arrivals():
                if each.topic in heard:
                    counts[heard[each.topic]] += 1
            return counts

        def watch(since: dict[str, int]) -> dict[str, int]:
            deadline = time.monotonic() + _STARTS_WITHIN
            while count()[CONTROL] <= since[CONTROL] + 5:
                assert time.monotonic() < deadline, f"a topic without arming does not cross: {stage.describe(CONTROL)}"
                time.sleep(0.05)
            time.sleep(watched)
            return count()

        start = watch(count())

        def edit(place: str) -> None:
            case = places[place]
            found[case.name].codes = tuple(_step(stage, place, *step) for step in case.steps)

        with ThreadPoolExecutor(_EDITS_AT_ONCE) as pool:
            tuple(pool.map(edit, places))
        edited = watch(count()) if any(case.steps for case in places.values()) else start
        again = edited
        if edited is not start:
            stage.robot.kill()
            stage.robot.start()
            again = watch(count())
        for name, crossed in found.items():
            crossed.before, crossed.after = start[name], edited[name] - start[name]
            crossed.restarted = again[name] - edited[name]
    return found


def _step(stage: Stage, place: str, side: Side, command: str, arguments: Sequence[str]) -> int:
    bridge = stage.robot if side == "robot" else stage.pc
    return bridge.run(command, *(each.replace("@", place) for each in arguments)).wait()


def _sessions(places: dict[str, Case], server: Side) -> dict[Side, dict[str, Any]]:
    flip = server == "robot"
    topics = {
        side: [
            _placed(entry, place, flip=flip)
            for place, case in places.items()
            for entry in (case.robot if side == "robot" else case.pc)
        ]
        for side in ("robot", "pc")
    }
    made: dict[Side, dict[str, Any]] = {}
    for side in ("robot", "pc"):
        client = {"name": "robot1", "key_file": "key.txt", "topics": topics[side]}
        made[side] = {"clients": [client]} if side == server else {"topics": topics[side]}
        armed = [name.replace("@", place) for place, case in places.items() for at, name in case.armed if at == side]
        if armed:
            made[side][_ARMED_KEY] = armed
    return made


def _placed(entry: dict[str, Any], place: str, *, flip: bool) -> dict[str, Any]:
    """An entry with its names, as the client sees it: where the control PC is the client, the other way round."""
    placed = {key: value.replace("@", place) if isinstance(value, str) else value for key, value in entry.items()}
    if flip:
        here, there = placed["topic"], placed.get("remote_topic", placed["topic"])
        placed |= {"topic": there, "remote_topic": here} if here != there else {}
        placed["direction"] = {"receive": "transmit", "transmit": "receive"}[placed["direction"]]
    return placed
