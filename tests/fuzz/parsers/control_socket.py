"""Control sockets: what a console asks of a bridge, and what a bridge tells a console."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from tests.console.scripted import ScriptedEngine
from tests.fuzz.editing import behind, edit_frames
from tests.fuzz.parser import Parser

from rsb_bridge.control import protocol
from rsb_bridge.control.protocol import (
    BridgeInfo,
    CommandFailed,
    CommandRequest,
    CommandWithdrawn,
    ConsoleHello,
    ConsoleWelcome,
    ControlProtocolError,
    Events,
    FollowEvents,
    Goodbye,
    PollState,
    Reply,
    StateChange,
    Summary,
    Watch,
)
from rsb_bridge.control.states import StateReceiver
from rsb_bridge.model.commands import AddTopic, PauseTopics, Peek, Restart, Topics
from rsb_bridge.model.session import Topic

_INFO = BridgeInfo("robot1", "client", "10.0.0.20:49152", 1, 0.0, "x", "0.1.0")


def _read(make: Callable[[], protocol.Frames[Any]], data: bytes) -> None:
    """Messages in pieces, as the first byte says; each is the same after another crossing."""
    frames, receiver = make(), StateReceiver(_INFO)
    size = data[0] if data and data[0] else len(data) or 1
    content = data[1:]
    try:
        for at in range(0, len(content), size):
            for message in frames.feed(content[at : at + size]):
                _check_same(make, message)
                if isinstance(message, StateChange):
                    receiver.receive(message)
    except ControlProtocolError:
        pass  # the connection ends
    if receiver.snapshot is not None:
        assert receiver.session is not None


def _check_same(make: Callable[[], protocol.Frames[Any]], message: Any) -> None:
    encoded = protocol.encode(message)
    (again,) = make().feed(encoded)
    assert protocol.encode(again) == encoded


def _state() -> bytes:
    engine = ScriptedEngine()
    routes = tuple(map(protocol.encode_route, engine.now.routes[:1]))
    keys = tuple(route.key for route in engine.now.routes[:1])
    return protocol.encode(StateChange(routes=routes, keys=keys, session=engine.session, links=engine.now.links[:1]))


def _frames(messages: tuple[Any, ...]) -> bytes:
    return b"".join(protocol.encode(message) for message in messages)


_TO_BRIDGE = (
    ConsoleHello(1, "0.1.0"),
    CommandRequest(1, AddTopic(Topic("/scan", "transmit"))),
    CommandRequest(2, PauseTopics("/scan", paused=True)),
    CommandRequest(3, Restart()),
    CommandRequest(4, Topics()),
    CommandRequest(5, Peek("/scan")),
    CommandWithdrawn(5),
    PollState(),
    FollowEvents(7),
    Watch(),
)
_TO_CONSOLE = (
    ConsoleWelcome(_INFO),
    Reply(1, "key"),
    CommandFailed(2, "no such topic"),
    Events(()),
    Summary(b"figures"),
    Goodbye("the bridge ends"),
)

PARSERS = (
    Parser(
        "control_requests",
        partial(_read, protocol.frames_to_bridge),
        (bytes(1) + _frames(_TO_BRIDGE), b"\7" + protocol.encode(_TO_BRIDGE[1])),
        behind(1, edit_frames),
    ),
    Parser(
        "control_answers",
        partial(_read, protocol.frames_to_console),
        (bytes(1) + _frames(_TO_CONSOLE), bytes(1) + _state()),
        behind(1, edit_frames),
    ),
)
