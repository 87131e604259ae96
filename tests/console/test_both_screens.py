"""A row for each cause that keeps a topic from being heard: what both screens and both JSON streams say of it.

One pair of consoles, in real terminals, bridges a topic for each row; real nodes publish and subscribe as the row says.
A relay between the two sides holds the messages of one topic.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import signal
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import pytest
from tests.console.live import Pair, running
from tests.console.nodes import Spec, encoded
from tests.console.side import Side, every_so_often
from tests.support.log_lines import check_lines
from tests.support.ports import free_ports
from tests.support.relay import Relay
from tests.support.waiting import eventually

from rsb_bridge.config.session_file import save
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_console.notation.glyphs import STATE_SIGN, STATE_WORD

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.support.forker import Forked

pytestmark = pytest.mark.skipif(shutil.which("tmux") is None, reason="it needs tmux (apt install tmux)")


class Row(NamedTuple):
    """A cause, with its display on both sides.

    Attributes:
        topic: the client's entry.
        robot: nodes on the client's side.
        pc: nodes on the server's side.
        state: of the topic, on both sides.
        cause: in both JSON streams.
        client: words on the client's screen, in this order, with " … " between them.
        server: the display on the server's side.
        logged: both logs warn of it.
        comes: the node that starts last, when all is fine.
        leaves: the node that goes first, after all was fine: a subscriber ends, a publisher hangs. (DDS lists one that
            was killed for 20 s, and a busy machine takes longer to ask both sides; `tests.engine.test_verdicts` kills.)
        held: s by which the relay delays each message, once the topic is fine.
    """

    name: str
    topic: Topic
    robot: tuple[Spec, ...]
    pc: tuple[Spec, ...]
    state: State
    cause: Cause
    client: str
    server: str
    logged: bool = True
    comes: str = ""
    leaves: str = ""
    held: float = 0.0


# fmt: off
ROWS = (
    Row("a best-effort publisher on a reliable route", Topic("/lidar", "transmit", qos="default"),
        (Spec("laser", "/lidar", 20, best_effort=True),), (Spec("mapper", "/lidar"),),
        State.DOWN, Cause.QOS_INCOMPATIBLE,
        "/laser offers best_effort … asks for reliable … set qos: auto",
        "robot1: /laser offers best_effort … asks for reliable … set qos: auto"),
    Row("a far subscriber that asks for reliable", Topic("/imu", "transmit"),
        (Spec("gyro", "/imu", 20, best_effort=True),), (Spec("planner", "/imu"),),
        State.UNHEARD, Cause.QOS_INCOMPATIBLE,
        "server: /planner asks for reliable … with best_effort … reaches the subscribers of /imu there",
        "/planner asks for reliable … is published with best_effort"),
    Row("a far subscriber with another type", Topic("/gps", "transmit"),
        (Spec("receiver", "/gps", 20),), (Spec("odd", "/gps", type="Int32"),),
        State.UNHEARD, Cause.TYPE_CONFLICT,
        "server: /odd has std_msgs/msg/Int32 … carries std_msgs … reaches the subscribers of /gps there",
        "/odd has std_msgs/msg/Int32, but /gps carries std_msgs/msg/String … the subscribers of /gps in domain"),
    Row("2 Hz of 20 expected", Topic("/odom", "transmit", expected_rate=20.0),
        (Spec("wheels", "/odom", 2),), (Spec("mapper", "/odom"),),
        State.SLOW, Cause.SLOW,
        "Hz of 20 expected, for … that is all that /wheels publishes",
        "robot1: … Hz of 20 expected, for … that is all that /wheels publishes"),
    Row("a name that is typed wrong", Topic("/w_tpyo", "transmit"),
        (Spec("typist", "/w_typo", 5),), (),
        State.WAITING, Cause.SIMILAR_NAME,
        "no publisher of /w_tpyo in domain … did you mean /w_typo?",
        "robot1: no publisher of /w_tpyo in domain … did you mean /w_typo?"),
    Row("a name with the prefix of another namespace", Topic("/robot7/w_front", "transmit"),
        (Spec("front", "/w_front", 5),), (),
        State.WAITING, Cause.SIMILAR_NAME,
        "no publisher of /robot7/w_front in domain … did you mean /w_front?",
        "robot1: no publisher of /robot7/w_front in domain … did you mean /w_front?"),
    Row("a direction that is reversed", Topic("/reversed", "receive"),
        (Spec("sonar", "/reversed", 5),), (),
        State.WAITING, Cause.PUBLISHED_THERE,
        "server: no publisher of /reversed in domain … /sonar publishes it on robot1: direction: transmit?",
        "no publisher of /reversed in domain … /sonar publishes it on robot1: direction: transmit?"),
    Row("a reversed direction, and a name that is typed wrong", Topic("/w_sonra", "receive"),
        (Spec("pinger", "/w_sonar", 5),), (),
        State.WAITING, Cause.PUBLISHED_THERE,
        "server: no publisher of /w_sonra … /pinger publishes /w_sonar on robot1: direction: transmit, and that name?",
        "no publisher of /w_sonra … /pinger publishes /w_sonar on robot1: direction: transmit, and that name?"),
    Row("the same on the server's side", Topic("/robot7/w_plan", "transmit"),
        (), (Spec("strategist", "/w_plan", 5),),
        State.WAITING, Cause.PUBLISHED_THERE,
        "no publisher of /robot7/w_plan in domain … /strategist publishes /w_plan on the server: direction: receive",
        "robot1: … /strategist publishes /w_plan on the server: direction: receive, and that name?"),
    Row("two types on one topic", Topic("/mixed", "transmit"),
        (Spec("one", "/mixed", 5), Spec("other", "/mixed", 5, type="Int32", alone=True)), (Spec("mapper", "/mixed"),),
        State.UNHEARD, Cause.TYPE_CONFLICT,
        "std_msgs/msg/Int32 (from /other) is not bridged, only std_msgs/msg/String (from /one)",
        "robot1: … std_msgs/msg/Int32 (from /other) is not bridged, only std_msgs/msg/String (from /one)",
        comes="other"),
    Row("throttled on purpose", Topic("/pose", "transmit", max_rate=5.0),
        (Spec("locator", "/pose", 25),), (Spec("mapper", "/pose"),),
        State.OK, Cause.THROTTLED,
        "limit 5 Hz, set on purpose … delivered … throttled … limit 5 Hz",
        "limit 5 Hz, set on purpose … delivered … throttled … limit 5 Hz", logged=False),
    Row("too large for UDP", Topic("/picture", "transmit", protocol="udp"),
        (Spec("camera", "/picture", 1, size=9 << 20, alone=True),), (Spec("mapper", "/picture"),),
        State.DOWN, Cause.TOO_LARGE,
        "none of the last … for … larger than its transport carries … use protocol: tcp",
        "robot1: none of the last … for … larger than its transport carries … use protocol: tcp"),
    Row("no far subscriber any more", Topic("/lonely", "transmit"),
        (Spec("hermit", "/lonely", 20),), (Spec("visitor", "/lonely", alone=True),),
        State.UNHEARD, Cause.NO_SUBSCRIBER,
        "server: nobody subscribes to /lonely in domain",
        "nobody subscribes to /lonely in domain", leaves="visitor"),
    Row("a publisher that hangs", Topic("/battery", "transmit"),
        (Spec("mortal", "/battery", 20, alone=True),), (Spec("mapper", "/battery"),),
        State.STOPPED, Cause.PUBLISHER_SILENT,
        "nothing for … Hz expected: /mortal has stopped publishing, or died",
        "robot1: nothing for … Hz expected: /mortal has stopped publishing, or died", leaves="mortal"),
    Row("messages that take too long", Topic("/chat", "transmit"),
        (Spec("talker", "/chat", 1),), (Spec("listener", "/chat"),),
        State.LATE, Cause.LATE, "", "", held=3.0),
)
# fmt: on
_RELAYED = "127.0.0.2"
"""Where the client finds the server: relays listen there."""
_FINE_FOR = 20
"""Messages, in 1 s. On one core with a busy loop a node publishes a tenth of that, and 100 took over a minute."""
_RATE_IS_KNOWN = re.compile(r" [\d.]+/\d")  # a busy machine publishes less often than it should


class World:
    """Both consoles, the nodes in their domains, and both sides' last JSON.

    Attributes:
        sides: the client's and the server's.
    """

    def __init__(self, folder: Path, domains: tuple[int, int], nodes: contextlib.ExitStack) -> None:
        held = [row.name for row in ROWS if row.held]
        self._ports = dict(zip(held, free_ports(len(held)), strict=True))
        topics = (msgspec.structs.replace(row.topic, port=self._ports.get(row.name)) for row in ROWS)
        pair = Pair(folder, *topics, domains=domains, stale_after=120.0)
        ports = {pair.client.server_port, *self._ports.values()}
        self._relays = {port: nodes.enter_context(Relay(("127.0.0.1", port), _RELAYED, port)) for port in ports}
        save(msgspec.structs.replace(pair.client, server_ip=_RELAYED), pair.client_path)
        self._starts: dict[str, Callable[[], Forked]] = {}
        for domain, specs in zip(domains, ([row.robot for row in ROWS], [row.pc for row in ROWS]), strict=True):
            flat = [spec for each in specs for spec in each]
            nodes.enter_context(_nodes(domain, [spec for spec in flat if not spec.alone]))
            for spec in (spec for spec in flat if spec.alone):
                self._starts[spec.node] = partial(nodes.enter_context, _nodes(domain, [spec]))
        late = {row.comes for row in ROWS}
        self._alone = {node: start() for node, start in self._starts.items() if node not in late}
        paths = {"server": pair.server_path, "client": pair.client_path}
        made = {role: Side(folder / role, folder / f"{role}.sock", "run", str(path)) for role, path in paths.items()}
        self.sides = made["client"], made["server"]
        for side in self.sides:
            nodes.callback(side.close)
        self._statuses: list[dict[str, Any]] = [{"routes": []}, {"routes": []}]
        self._events: list[list[dict[str, Any]]] = [[], []]

    def routes(self, row: Row, *, anew: bool = False) -> list[dict[str, Any]]:
        """Return a topic's part of both sides' JSON, as soon as both have its state and cause."""
        if anew:
            self._statuses = [side.status() for side in self.sides]

        def shown() -> list[dict[str, Any]]:
            every = [each for status in self._statuses for each in status["routes"] if each["topic"] == row.topic.topic]
            found = [each for each in every if (each["state"], each["cause"]) == (row.state, row.cause)]
            if len(found) < 2:
                self._statuses = [side.status() for side in self.sides]
            return found if len(found) == 2 else []

        found: list[dict[str, Any]] = every_so_often(shown, f"{row.state} and {row.cause} on both sides")
        return found

    def warnings(self, row: Row) -> list[dict[str, Any]]:
        """The events of both sides that name a topic's cause."""

        def shown() -> list[dict[str, Any]]:
            waits = row.state is State.WAITING
            about = (EventCode.ROUTE_WAITING if waits else EventCode.ROUTE_FAULT, row.topic.topic, row.cause)
            found = [
                [event for event in events if (event["code"], event["topic"], event["cause"]) == about]
                for events in self._events
            ]
            if not all(found):
                self._events = self.events()
            return [event for events in found for event in events] if all(found) else []

        found: list[dict[str, Any]] = every_so_often(shown, f"{row.cause} in both logs")
        return found

    def events(self) -> list[list[dict[str, Any]]]:
        return [side.events() for side in self.sides]

    def act(self, row: Row) -> None:
        """Wait until the topic is fine, and start or end a node."""
        fine = row._replace(state=State.OK, cause=Cause.NONE)
        if row.comes:
            self.routes(fine)
            self._starts[row.comes]()
        if row.leaves:
            self._end(row, fine)
        if row.held:
            self.routes(fine)
            self._relays[self._ports[row.name]].delay = lambda: row.held

    def _end(self, row: Row, fine: Row) -> None:
        before = self.routes(fine)
        every_so_often(
            lambda: all(
                new["offered"] >= old["offered"] + _FINE_FOR
                for new, old in zip(self.routes(fine, anew=True), before, strict=True)
            ),
            "it flows",
        )
        for side in self.sides:
            side.choose(row.topic.topic)
            eventually(lambda side=side: _RATE_IS_KNOWN.search(side.screen.picture), what="its rate is shown")
        process = self._alone[row.leaves]
        if any(spec.node == row.leaves for spec in row.robot):
            process.send_signal(signal.SIGUSR1)
        else:
            process.terminate()
            process.wait()


def _nodes(domain: int, specs: list[Spec]) -> contextlib.AbstractContextManager[Forked]:
    return running("tests.console.nodes", str(domain), encoded(specs))


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory, _domains: int) -> Iterator[World]:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    with pytest.MonkeyPatch.context() as patch, contextlib.ExitStack() as nodes:
        folder = tmp_path_factory.mktemp("world")
        patch.setenv("XDG_STATE_HOME", str(folder))
        yield World(folder, (_domains, _domains + 1), nodes)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_both_sides_name_the_cause(world: World, row: Row) -> None:
    world.act(row)
    gone = row.leaves if row.cause is Cause.NO_SUBSCRIBER else ""
    sends = row.topic.direction == "transmit"
    publishers = [f"/{spec.node}" for spec in row.robot if sends and spec.topic == row.topic.topic]
    ends = publishers, [f"/{spec.node}" for spec in row.pc if spec.node != gone and spec.topic == row.topic.topic]

    def named(routes: list[dict[str, Any]]) -> bool:
        return all((route["publishers"], route["subscribers"]) == ends for route in routes)

    if not named(world.routes(row)):
        every_so_often(lambda: named(world.routes(row, anew=True)), f"the nodes {ends} on both sides")
    for side, words in zip(world.sides, (row.client, row.server), strict=True):
        side.choose(row.topic.topic)
        side.says(*(each for each in words.split(" … ") if each))
        side.screen.wait_for(f"{STATE_SIGN[row.state]} {STATE_WORD[row.state]}")
    if row.logged:
        for event in world.warnings(row):
            assert event["level"] == "WARNING"


def test_the_first_screen_counts_what_is_wrong(world: World) -> None:
    states = [row.state for row in ROWS]
    for side in world.sides:
        for state in set(states):
            side.screen.wait_for(f"{STATE_SIGN[state]} {states.count(state)} {STATE_WORD[state].lower()}")


def test_every_line_names_its_link(world: World) -> None:
    for side in world.sides:
        events = every_so_often(side.events, "its log")
        check_lines(events)
        assert {"link", "route"} <= {event["source"] for event in events}
