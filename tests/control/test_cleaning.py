"""An engine elsewhere that has been taken over: what it says does nothing to a terminal, and can be drawn."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any, get_args

import msgspec
import pytest
from tests.console.scripted import CALL_ROUTES, EVENTS, LINK, ROUTES, SESSION
from tests.support import constants
from tests.support.lying import ESCAPES, nasty
from tests.support.operators import BOB, Reachable, Stranger
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.control import protocol
from rsb_bridge.control.protocol import BridgeInfo, ControlProtocolError, ToConsole, UnexpectedMessage
from rsb_bridge.control.states import (
    LONGEST_TEXT,
    MOST_ITEMS,
    ROUTE_BYTES,
    StateReceiver,
    UntrustedMessages,
    check_routes,
    clean,
)
from rsb_bridge.model.snapshot import Event, Level, RouteSnapshot
from rsb_bridge.model.text import is_clean
from rsb_bridge.telemetry.event_log import KEPT
from rsb_bridge.wire.framing import pack_frame

BRIDGE = BridgeInfo("robot1", "client", "10.0.0.20:49152", 1, 0.0, "i", "0.1")


def all_in(value: Any) -> Any:
    """Return all values of a message, at any depth."""
    plain = msgspec.to_builtins(value)
    waiting = [plain]
    while waiting:
        each = waiting.pop()
        yield each
        if isinstance(each, dict):
            waiting += [*each, *each.values()]
        elif isinstance(each, list | tuple):
            waiting += each


KINDS: tuple[type, ...] = get_args(ToConsole)


@pytest.mark.parametrize("figure", [math.nan, math.inf, -math.inf, 1e308])
@pytest.mark.parametrize("kind", [*KINDS, RouteSnapshot], ids=lambda kind: kind.__name__)
def test_every_text_and_figure_is_cleaned(kind: type, figure: float) -> None:
    said = msgspec.msgpack.encode(nasty(msgspec.inspect.type_info(kind), ESCAPES, figure))
    made: Any = msgspec.msgpack.decode(said, type=kind)
    dirty = [each for each in all_in(made) if isinstance(each, str) and not is_clean(each)]
    assert dirty or kind is protocol.Summary, "the test has something to find"
    for each in all_in(clean(made)):
        if isinstance(each, str):
            assert is_clean(each)
        elif isinstance(each, float):
            assert math.isfinite(each)
            time.localtime(each)
        elif isinstance(each, int):
            assert each >= 0


@pytest.mark.parametrize(
    "value", [ROUTES, CALL_ROUTES, LINK, SESSION, EVENTS, BRIDGE], ids=lambda value: type(value).__name__
)
def test_what_honest_engine_says_is_as_it_was(value: object) -> None:
    assert clean(value) == value


def test_answers_keep_lines_other_texts_have_one() -> None:
    assert clean(protocol.Reply(1, "a:\n\tb\x1b[m")).value == "a:\n\tb\ufffd[m"
    assert clean(protocol.CommandFailed(1, "no\nsuch\x9b")).reason == "no\nsuch\ufffd"
    (event,) = clean(protocol.Events((Event(1, 0.0, Level.INFO, "a\nb", "t"),))).events
    assert event.code == "a\ufffdb"
    assert len(clean(protocol.CommandFailed(1, "x" * 100_000)).reason) == LONGEST_TEXT
    assert len(clean(protocol.RestartStep(1, "x" * 100_000)).text) == LONGEST_TEXT


def test_data_of_too_many_levels_is_refused() -> None:
    refused = 0
    depths = range(500, 1600)  # Pythons take 750 to 1000, with few left in a test, and their decoder up to 1500
    for levels in depths:
        frames = protocol.frames_to_console()
        try:
            for message in frames.feed(pack_frame(msgspec.msgpack.encode(protocol.Reply(1, nested(levels))))):
                clean(message)
        except ControlProtocolError:
            refused += 1
    assert 0 < refused < len(depths)


def nested(levels: int) -> msgspec.Raw:
    return msgspec.Raw(b"\x91" * levels + b"\xc0")


def test_too_much_is_refused() -> None:
    with pytest.raises(ControlProtocolError):
        clean(protocol.StateChange(keys=("a",) * (MOST_ITEMS + 1)))
    with pytest.raises(ControlProtocolError):
        check_routes([msgspec.Raw(b"x" * (ROUTE_BYTES + 1))])
    untrusted = UntrustedMessages(0.0)
    events = protocol.Events(EVENTS[:1] * protocol.EVENTS_AT_ONCE)
    for _ in range(KEPT // protocol.EVENTS_AT_ONCE):
        untrusted(events, 0.0)

    def tell_for_long() -> None:
        for _ in range(KEPT):
            untrusted(events, 0.0)

    with pytest.raises(ControlProtocolError):
        tell_for_long()


def test_routes_that_are_never_listed_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    constants.CLEANED_ITEMS.set(monkeypatch, 300)
    receiver = StateReceiver(BRIDGE, trusted=False)
    for first in range(0, 300, 100):
        assert not receiver.receive(some_routes(first))
    with pytest.raises(ControlProtocolError):
        receiver.receive(some_routes(300))


def some_routes(first: int) -> protocol.StateChange:
    """A hundred routes, of a state that goes on."""
    routes = (replace(ROUTES[0], key=str(first + number)) for number in range(100))
    return protocol.StateChange(routes=tuple(map(protocol.encode_route, routes)), more=True)


@pytest.mark.parametrize("keys", [(ROUTES[0].key,) * 2, None])
def test_routes_missing_in_list_are_refused(keys: tuple[str, ...] | None) -> None:
    state = protocol.StateChange(routes=(protocol.encode_route(ROUTES[0]),), keys=keys, links=(LINK,), session=SESSION)
    with pytest.raises(ControlProtocolError, match=pattern(UnexpectedMessage.ROUTES_NOT_AS_LISTED)):
        StateReceiver(BRIDGE, trusted=False).receive(state)


def test_captured_robot_does_nothing_to_attached_console(reachable: Reachable) -> None:
    reachable.engine.now = replace(
        reachable.engine.now,
        address=ESCAPES,
        time=math.inf,
        links=(replace(LINK, reason=ESCAPES, peer=ESCAPES, rtt=math.nan, attempts=-(10**9)),),
        routes=(replace(ROUTES[0], reason=ESCAPES, rate=math.inf, since=1e300, history=(-5,) * 120),),
    )
    reachable.engine.happened = [Event(1, math.nan, Level.INFO, ESCAPES, ESCAPES, who=ESCAPES)]
    reachable.engine.described = f"a:\n {ESCAPES}"
    remote = reachable.attach()
    eventually(remote.events)
    for each in (remote.snapshot(), remote.session, remote.bridge, remote.topics().result(60)):
        assert each == clean(each)
    (event,) = remote.events()
    assert is_clean(event.text + event.code + event.who)
    assert math.isfinite(event.time)
    description = remote.describe("/robot1/scan").result(60)
    assert description.startswith("a:\n ")
    assert is_clean(description.replace("\n", ""))


def test_an_answer_of_another_kind_is_no_answer(reachable: Reachable) -> None:
    reachable.engine.described = LINK  # what only a rogue sends
    remote = reachable.attach()
    with pytest.raises(EngineError):
        remote.describe("/robot1/scan").result(60)
    remote.retry().result(60)


def test_rogue_operator_asks_nonsense_and_looks_forever(reachable: Reachable, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.CONSOLE_ANSWERED_WITHIN.set(monkeypatch, 600.0)  # then an old state is sent again
    with Stranger(reachable.port, "bob", BOB) as rogue:
        rogue.attach()
        for _ in range(1000):
            rogue.say(protocol.PollState())
        for after in (-(2**63), 2**63 - 1, -1, 0):
            rogue.say(protocol.FollowEvents(after))
        heard: list[object] = []
        while not any(isinstance(message, protocol.Events) for message in heard):
            heard.append(rogue.answer())
        assert sum(isinstance(message, protocol.StateChange) for message in heard) <= 2, "the state has not changed"
    assert [route.key for route in reachable.attach().snapshot().routes] == [route.key for route in ROUTES]
