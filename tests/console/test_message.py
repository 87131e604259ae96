"""Looking at a topic's messages in the console."""

import threading
from dataclasses import replace
from typing import Any

import pytest
from tests.console.driving import NARROW, engine_of, gone, on_main, put, shown, shown_at_the_end, text, until
from tests.console.scripted import NOW, ScriptedEngine, route
from tests.support import replaced
from tests.support.wording import says
from textual.pilot import Pilot

from rsb_bridge.model.snapshot import PeekedMessage, State
from rsb_console.app import ConsoleApp
from rsb_console.screens.message_screen import MessageText
from rsb_console.session.reading import (
    ArrivalText,
    ReadMessage,
    StampText,
    hex_lines,
    message_lines,
    plain,
    read_message,
)

pytest.importorskip("rclpy", reason="needs ROS 2")

from geometry_msgs.msg import Point
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from rsb_bridge.cdr.decoder import Items
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.ros.native.typesupport import hash_of

TEXT = "std_msgs/msg/String"


class TextEngine(ScriptedEngine):
    """Its topics have a type that is shown as text, since it has no picture."""

    def __init__(self, *session: Any) -> None:
        super().__init__(*session)
        self.now = replace(self.now, routes=tuple(replace(each, type_name=TEXT) for each in self.now.routes))


def peeked(message: Any, **changes: Any) -> PeekedMessage:
    kind = f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"
    payload = serialize_message(message)
    shows = PeekedMessage(payload, len(payload), kind, hash_of(type(message)), NOW, outgoing=False, latency=0.0031)
    return replace(shows, **changes)


def odometry(frame: str = "base") -> Odometry:
    message = Odometry(child_frame_id=frame)
    message.header.stamp.sec, message.header.stamp.nanosec = int(NOW) - 1, 995_000_000
    return message


async def answered(pilot: Pilot[None], message: PeekedMessage | None) -> None:
    """Let a message come once the screen waits for the next one, which may be after it has drawn the one before."""
    assert isinstance(pilot.app, ConsoleApp)
    engine = engine_of(pilot.app)
    await until(pilot, lambda: not engine.looking.done(), "a look at the next message")
    engine.looking.set_result(message)


@pytest.mark.parametrize("keys", [["v"], ["enter", "enter"]])
@on_main(make_engine=TextEngine)
async def test_topic_shows_latest_message_and_later_ones(app: ConsoleApp, pilot: Pilot[None], keys: list[str]) -> None:
    engine = engine_of(app)
    engine.described = installed_description("nav_msgs/msg/Odometry")
    engine.peeked.append(peeked(odometry()))
    await pilot.press(*keys)
    await shown(pilot, 'child_frame_id: "base"')
    screen = text(app)
    assert says(screen, ArrivalText.OVER_LINK, size="nav_msgs/msg/Odometry  716 B", took=" in 3.1 ms")
    assert says(screen, StampText.AGE, stamp="header.stamp", span="5.0 ms", clocks=StampText.CLOCKS_OF_PUBLISHER())
    assert engine.commands[:2] == [("peek", "/robot2/scan", True), ("describe", "/robot2/scan")]
    await answered(pilot, peeked(odometry("other")))
    await shown(pilot, 'child_frame_id: "other"')
    assert engine.commands.count(("describe", "/robot2/scan")) == 1, "the type is described"
    await answered(pilot, None)
    await shown(pilot, MessageText.WAITING)
    await shown(pilot, 'child_frame_id: "other"')  # the last one stays
    await until(pilot, lambda: not engine.looking.done(), "a look at the next message")
    await pilot.press("escape")
    await gone(pilot, "child_frame_id")
    await until(pilot, engine.looking.cancelled, "nobody looks any more")


@on_main(make_engine=TextEngine)
async def test_keys_do_something_while_a_message_is_read(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    began, may_go_on = threading.Event(), threading.Event()

    def slow(*arguments: Any, **limits: Any) -> ReadMessage:
        began.set()
        assert may_go_on.wait(30), "the screen waits for the message"
        return read_message(*arguments, **limits)

    replaced.READ_MESSAGE.set(monkeypatch, slow)
    engine_of(app).described = installed_description("nav_msgs/msg/Odometry")
    engine_of(app).peeked.append(peeked(odometry()))
    await pilot.press("v")
    await until(pilot, began.is_set, "reading begins")
    await pilot.press("space")
    await shown(pilot, "HELD")
    may_go_on.set()
    await shown(pilot, 'child_frame_id: "base"')


@on_main(make_engine=TextEngine, readonly=True)
async def test_a_message_can_be_held(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine = engine_of(app)
    engine.described = installed_description("std_msgs/msg/String")
    engine.peeked.append(peeked(String(data="first")))
    await pilot.press("v")
    await shown(pilot, 'data: "first"')
    await pilot.press("space")
    await shown(pilot, "HELD")
    await answered(pilot, peeked(String(data="second")))
    await pilot.press("space")
    await shown(pilot, 'data: "second"')


@on_main(NARROW, make_engine=TextEngine)
async def test_why_no_message_comes_is_said(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, route("/quiet", State.WAITING, type_name=TEXT, reason="no publisher of /quiet in domain 4"))
    await shown(pilot, "/quiet")
    await pilot.press("v")
    await shown(pilot, MessageText.WAITING)
    await shown(pilot, "WAIT no publisher of /quiet in domain 4")


@on_main(NARROW, make_engine=TextEngine)
async def test_what_nobody_describes_is_shown_as_hex(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine_of(app).peeked.append(peeked(odometry(), payload=bytes(range(64)) * 100))
    await pilot.press("v")
    await shown(pilot, "00000010  10 11 12 13")
    await shown(pilot, "nav_msgs/msg/Odometry")
    await shown_at_the_end(pilot, "neither side knows it")


@on_main(make_engine=TextEngine)
async def test_nothing_in_message_is_obeyed_by_screen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine_of(app).described = installed_description("std_msgs/msg/String")
    engine_of(app).peeked.append(peeked(String(data="\x1b[2J [red]markup[/] \u202e\u200b")))
    await pilot.press("v")
    await shown(pilot, 'data: "\\x1b[2J [red]markup[/] \\u202e\\u200b"')


@on_main(make_engine=TextEngine)
async def test_a_message_of_many_lines_shows_the_first(app: ConsoleApp, pilot: Pilot[None]) -> None:
    markers = MarkerArray(markers=[Marker(points=[Point()] * 100)] * 300)
    engine_of(app).described = installed_description("visualization_msgs/msg/MarkerArray")
    engine_of(app).peeked.append(peeked(markers))
    await pilot.press("v")
    await shown(pilot, " of 300 visualization_msgs/msg/Marker")
    await shown_at_the_end(pilot, "only the first 2 000 lines are shown")


def test_arrays_are_wrapped_and_shortened() -> None:
    message = {
        "ranges": Items("float32", 1000, [0.5] * 20),
        "few": Items("float64", 2, [1.5]),
        "all": Items("uint8", 20, [7] * 20),
        "points": Items("p/msg/Point", 3, [{"x": 1, "y": 2}, {"x": 3, "y": 4}]),
        "empty": Items("uint8", 0, []),
        "nested": {"names": Items("string", 2, ["a", "b\n"])},
        "nothing": {},
    }
    lines = [plain(line) for line in message_lines(message, 60)]  # type: ignore[arg-type]
    assert lines == [
        "ranges:  # 20 of 1 000 float32",
        "  [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5,",
        "   0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, …]",
        "few: [1.5, …]  # 1 of 2 float64",
        "all: [7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7,",
        "      7, 7, 7]",
        "points:  # 2 of 3 p/msg/Point",
        "- x: 1",
        "  y: 2",
        "- x: 3",
        "  y: 4",
        "empty: []",
        "nested:",
        '  names: ["a", "b\\n"]',
        "nothing: {}",
    ]
    short = [plain(line) for line in message_lines(message, 60, arrays=False)]  # type: ignore[arg-type]
    assert short[:2] == ["ranges: '<float32[1000]>'", "few: '<float64[2]>'"]


def test_hex_shows_sixteen_bytes_a_line() -> None:
    assert [plain(line) for line in hex_lines(b"\x00\x01\x00\x00ab\x1b", 16)] == [
        "00000000  00 01 00 00 61 62 1b                              ....ab."
    ]
    assert plain([*hex_lines(bytes(100), 32)][-1]) == "… 68 bytes more"
