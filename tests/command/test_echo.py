"""The command `echo`: what it prints of messages, decoded and not, and how it exits."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from tests.console.scripted import NOW, SESSION, ScriptedEngine, route
from tests.support.wording import says

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import PeekedMessage
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.ros.native.typesupport import hash_of
from rsb_console.command.watching_commands import WatchingProblem
from rsb_console.session.reading import ArrivalText, StampText

if TYPE_CHECKING:
    from tests.support.control import Machine

SCAN = route("/scan", outgoing=True, spec=Topic("/scan", "transmit"))


@pytest.fixture
def engine(machine: Machine) -> ScriptedEngine:
    return machine.have(ScriptedEngine(msgspec.structs.replace(SESSION, topics=(SCAN.spec,)), routes=(SCAN,)))


def peeked(message: Any, **changes: Any) -> PeekedMessage:
    kind = f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"
    payload = serialize_message(message)
    shown = PeekedMessage(payload, len(payload), kind, hash_of(type(message)), NOW + 0.25, outgoing=False)
    return replace(shown, **changes)


def odometry(stamp: float) -> Odometry:
    message = Odometry(child_frame_id="base")
    message.header.stamp.sec, message.header.stamp.nanosec = int(stamp), int(stamp % 1 * 1e9)
    message.pose.pose.position.x = 0.1
    return message


def shows(engine: ScriptedEngine, *messages: PeekedMessage) -> None:
    engine.peeked[:] = messages
    engine.described = installed_description(messages[0].type_name)


def test_it_prints_a_message_as_yaml(ran: Any, engine: ScriptedEngine) -> None:
    shows(engine, peeked(odometry(NOW + 0.125), latency=0.003, clock_offset=0.0, clock_uncertainty=1e-4))
    done = ran("echo", "/scan", "--once")
    assert done.code == 0
    first, second, *lines = done.out.splitlines()
    assert says(first, ArrivalText.OVER_LINK, size="716 B")
    assert " in 3.0 ms at " in first
    assert first.startswith("# nav_msgs/msg/Odometry, ")
    assert says(second, StampText.AGE, stamp="header.stamp", span="125.0 ms", clocks=StampText.CLOCKS_OF_PEER())
    assert lines[:4] == ["header:", "  stamp:", f"    sec: {int(NOW)}", "    nanosec: 125000000"]
    assert "      x: 0.1" in lines
    assert 'child_frame_id: "base"' in lines
    assert any(line.startswith("  covariance: [0.0, 0.0") for line in lines)
    assert lines[-1] == "---"
    assert engine.commands[0] == ("peek", "/scan", True)
    assert ("peek", "/scan", False) not in engine.commands


def test_for_programs_it_prints_one_object_a_message(ran: Any, engine: ScriptedEngine) -> None:
    shows(engine, *(peeked(odometry(NOW), outgoing=True) for _ in range(2)))
    done = ran("echo", "/scan", "--bridge", "robot1", "--count", "2", "--json", "--no-arr")
    assert done.code == 0
    (first, second) = map(json.loads, done.out.splitlines())
    assert first == second
    assert first["stamp"] == int(NOW * 1e9)
    assert first["stamp_latency"] == pytest.approx(0.25)
    assert first["stamp_clocks"] == StampText.CLOCKS_OF_PUBLISHER()
    assert first["message"]["pose"]["covariance"] == "<float64[36]>"
    assert first["message"]["child_frame_id"] == "base"
    assert [each for each in engine.commands if each[0] == "describe"] == [("describe", "/scan")]


@pytest.mark.parametrize(
    ("stamp", "changes", "words"),
    [
        (NOW + 5, {}, StampText.AHEAD(span="4.75 s")),
        (NOW + 5, {"clock_offset": 5.0, "clock_uncertainty": 0.001},
         StampText.AGE(stamp="header.stamp", span="250.0 ms", clocks=StampText.CLOCKS_OF_PEER())),
        (NOW - 10_000, {}, StampText.OLD(age="3h")),
        (0, {}, StampText.NOT_SET()),
        (NOW, {"is_kept": True}, StampText.KEPT()),
    ],
)  # fmt: skip
def test_stamp_that_says_no_latency_is_said_so(
    ran: Any, engine: ScriptedEngine, stamp: float, changes: dict[str, Any], words: str
) -> None:
    shows(engine, peeked(odometry(stamp), **changes))
    assert words in ran("echo", "/scan", "--once").out


def test_what_nobody_can_decode_is_shown_as_hex(ran: Any, engine: ScriptedEngine) -> None:
    engine.peeked[:] = [peeked(odometry(NOW), type_hash="RIHS01_" + "5a" * 32)]
    done = ran("echo", "/scan", "--once")
    assert says(done.out, StampText.AGE, stamp=StampText.GUESSED(), span="250.0 ms")
    assert "# 00000000  00 01 00 00" in done.out
    assert "# neither side knows it" in done.out
    engine.peeked[:] = [peeked(odometry(NOW))]
    shown = ran("echo", "/scan", "--once", "--json").json
    assert (shown["message"], shown["problem"], shown["stamp_guessed"]) == (None, "neither side knows it", True)
    assert bytes.fromhex(shown["hex"])[:4] == b"\x00\x01\x00\x00"


@pytest.mark.parametrize("payload", [b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + bytes(12), bytes(40)])
def test_bytes_without_stamp_are_not_taken_for_one(ran: Any, engine: ScriptedEngine, payload: bytes) -> None:
    engine.peeked[:] = [replace(peeked(String()), payload=payload, size=len(payload))]
    assert "header.stamp" not in ran("echo", "/scan", "--once").out


def test_of_a_large_message_it_prints_the_beginning(ran: Any, engine: ScriptedEngine) -> None:
    whole = peeked(String(data="x" * 3000))
    shows(engine, replace(whole, payload=whole.payload[:2000]))
    assert "# only the first 2 000 of 3 009 bytes are shown" in ran("echo", "/scan", "--once").out


def test_nothing_in_message_reaches_terminal_as_command(ran: Any, engine: ScriptedEngine) -> None:
    wild = '\x1b]0;title\x07 \u202eevil\u2066 zero\u200bwidth\ufeff "quoted" \\ \x9b31m \U000e0041 größer'
    shows(engine, *(peeked(String(data=wild)) for _ in range(2)))
    printed = ran("echo", "/scan", "--once").out
    assert '"\\x1b]0;title\\x07 \\u202eevil\\u2066 zero\\u200bwidth\\ufeff \\"quoted\\" \\\\ \\x9b31m' in printed
    assert "größer" in printed
    assert all(character.isprintable() or character == "\n" for character in printed)
    shown = ran("echo", "/scan", "--once", "--json")
    assert shown.json["message"]["data"] == wild
    assert shown.out.isascii()
    assert shown.out[:-1].isprintable()


def test_arrays_are_shortened_unless_they_are_wanted(ran: Any, engine: ScriptedEngine) -> None:
    from std_msgs.msg import Float32MultiArray

    message = peeked(Float32MultiArray(data=[0.1 * number for number in range(500)]))
    for _ in range(3):
        engine.peeked.append(message)
    engine.described = installed_description(message.type_name)
    shortened = ran("echo", "/scan", "--once").out
    assert "…]  # 128 of 500 float32" in shortened
    assert "0.1, 0.2, 0.3" in shortened
    whole = ran("echo", "/scan", "--once", "--full-length").out
    assert "49.9]" in whole
    assert "…" not in whole
    assert len(ran("echo", "/scan", "--once", "--json").json["message"]["data"]) == 500


def test_numbers_that_json_lacks(ran: Any, engine: ScriptedEngine) -> None:
    from std_msgs.msg import Float64MultiArray

    message = peeked(Float64MultiArray(data=[float("nan"), float("inf"), -float("inf"), 1.0]))
    shows(engine, message, message)
    assert ran("echo", "/scan", "--once", "--json").json["message"]["data"] == ["NaN", "Infinity", "-Infinity", 1.0]
    engine.peeked[:] = [message]
    assert "data: [.nan, .inf, -.inf, 1.0]" in ran("echo", "/scan", "--once").out


def test_where_nothing_comes_it_says_why(ran: Any, engine: ScriptedEngine) -> None:
    engine.now = replace(engine.now, routes=(replace(SCAN, reason="no publisher of /scan in domain 4"),))
    late = ran("echo", "/scan", "--timeout", "0.2")
    assert late.code == 1
    assert says(late.err, WatchingProblem.NO_MORE_MESSAGES, topic="/scan", seconds=0.2)
    assert "no publisher of /scan in domain 4" in late.err
    assert ran("echo", "/scn", "--once").code == 2
