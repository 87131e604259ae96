"""The control socket: every command arrives whole, however it is cut, and a console has the state of the engine.

Malformed input of a socket is in tests/fuzz.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, get_args

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.console.scripted import ScriptedEngine, route
from tests.control.protocol_helpers import fed
from tests.control.strangers_helpers import CHANGES
from tests.support.wording import pattern, says

from rsb_bridge.control import protocol
from rsb_bridge.control.protocol import AnyCommand, ControlProtocolError, StateChange
from rsb_bridge.control.states import EncodedRoutes, StateReceiver, StateSender
from rsb_bridge.model import commands
from rsb_bridge.model.session import Topic
from rsb_bridge.wire.protocol_error import Broken

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Snapshot

COMMANDS: tuple[AnyCommand, ...] = (
    *CHANGES,
    commands.KeepArmed(pressed=True),
    commands.ReleaseArmed(),
    commands.Topics("robot1"),
    commands.Peek("k", kept=True),
    commands.DescribeType("k"),
    commands.Template("k", "send_goal"),
)


@pytest.mark.parametrize("at_once", [1, 7, 1000])
def test_every_command_comes_through_whole(at_once: int) -> None:
    messages = [protocol.CommandRequest(number, command, undo=True) for number, command in enumerate(COMMANDS)]
    of_core = {each for each in get_args(AnyCommand) if each.__module__ == commands.__name__}
    assert {type(command) for command in COMMANDS} == of_core
    assert fed(b"".join(map(protocol.encode, messages)), to_bridge=True, at_once=at_once) == messages


@pytest.mark.parametrize(
    ("make", "limit"),
    [(protocol.frames_to_bridge, protocol.TO_BRIDGE_LIMIT), (protocol.frames_to_console, protocol.TO_CONSOLE_LIMIT)],
)
def test_frame_beyond_limit_is_refused_before_storing(make: Any, limit: int) -> None:
    with pytest.raises(ControlProtocolError, match=pattern(Broken.FRAME_TOO_LONG)):
        list(make().feed((limit + 1).to_bytes(4, "big")))


def test_a_message_of_ten_thousand_levels_is_refused() -> None:
    body = b"\x91" * 10_000 + b"\x90"
    with pytest.raises(ControlProtocolError, match="invalid"):
        fed(len(body).to_bytes(4, "big") + body, to_bridge=True)


@pytest.mark.parametrize("to_bridge", [True, False])
def test_text_that_is_not_utf_8_is_refused(to_bridge: bool) -> None:
    message = protocol.ConsoleHello(1, "words") if to_bridge else protocol.HelloRefused("words")
    body = protocol.encode(message)[4:].replace(b"words", b"\xa6ords")
    with pytest.raises(ControlProtocolError, match="invalid"):
        fed(len(body).to_bytes(4, "big") + body, to_bridge=to_bridge)


@settings(max_examples=settings().max_examples // 2, deadline=None)
@given(data=st.data())
def test_console_has_routes_that_engine_has(data: st.DataObject) -> None:
    """After routes are added, changed, removed and moved between two polls."""
    engine, sender, encoded = ScriptedEngine(), StateSender(), EncodedRoutes()
    info = protocol.BridgeInfo("robot1", "client", "10.0.0.20:49152", 1, 0.0, "x", "0.1.0")
    receiver = StateReceiver(info)
    pool = [route(f"/t{number}") for number in range(120)]
    for _ in range(4):
        chosen = data.draw(st.lists(st.integers(0, len(pool) - 1), unique=True))
        for number in data.draw(st.sets(st.integers(0, len(pool) - 1), max_size=5)):
            pool[number] = dataclasses.replace(pool[number], rate=data.draw(st.floats(0, 100)))
        topics = tuple(Topic(f"/t{number}", "receive") for number in chosen[:3])
        session = msgspec.structs.replace(engine.session, topics=topics)
        now = dataclasses.replace(engine.now, routes=tuple(pool[number] for number in chosen))
        wire = [
            protocol.encode(state)
            for state in sender.differences(now, session, waits_for_operator=False, encoded=encoded)
        ]
        encoded.keep_only(now)
        states = fed(b"".join(wire), to_bridge=False)
        assert [receiver.receive(state) for state in states] == [False] * (len(states) - 1) + [True]
        assert isinstance(states[-1], StateChange)
        assert receiver.snapshot == now
        assert receiver.session == session


def test_what_has_not_changed_is_not_sent_again() -> None:
    engine, sender, encoded = ScriptedEngine(), StateSender(), EncodedRoutes()
    first = engine.now

    def size(now: Snapshot) -> int:
        states = sender.differences(now, engine.session, waits_for_operator=False, encoded=encoded)
        return sum(len(protocol.encode(state)) for state in states)

    whole = size(first)
    assert size(dataclasses.replace(first, time=first.time + 1)) < whole / 10


def test_both_say_which_side_is_older() -> None:
    assert protocol.version_problem((1, "0.1"), (1, "0.2")) == ""
    assert says(
        protocol.version_problem((1, "0.1"), (2, "0.2")), protocol.VersionProblem.BRIDGE_OLDER, bridge=1, console=2
    )
    assert says(
        protocol.version_problem((2, "0.2"), (1, "0.1")), protocol.VersionProblem.CONSOLE_OLDER, bridge=2, console=1
    )
