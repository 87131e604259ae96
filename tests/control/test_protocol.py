"""The control socket: every message arrives whole, however it is cut, and nothing else does."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import types
import typing
from typing import Any, Literal, get_args, get_origin

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.console.scripted import ScriptedEngine, route
from tests.support.wording import says

from rsb_bridge.control import protocol
from rsb_bridge.control.protocol import ControlProtocolError, StateChange, ToBridge, ToConsole
from rsb_bridge.control.states import EncodedRoutes, Sender, StateReceiver
from rsb_bridge.model.by_hand import LONGEST_REST
from rsb_bridge.model.commands import EndLook, LookAtTopics, Publish
from rsb_bridge.model.pictures import Cells, Picture, Pixels, Viewed, Wish
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot

INTEGERS = st.integers(-(2**63), 2**63 - 1)
TEXTS = st.text(max_size=20)


VIEWED = st.builds(
    Viewed,
    picture=st.builds(
        Picture,
        content=st.none()
        | st.builds(Pixels, width=st.integers(1, 400), height=st.integers(1, 300), data=st.binary(max_size=50))
        | st.builds(Cells, rows=st.lists(TEXTS, max_size=3).map(tuple), styles=st.binary(max_size=9)),
        taken=INTEGERS,
    ),
    where=TEXTS,
    age=st.none() | st.floats(allow_nan=False),
)


VIEWERS = st.text(min_size=1, max_size=20)
LOOKS = st.builds(
    LookAtTopics,
    viewer=VIEWERS,
    topics=st.just(("/a", "/b")),
    wish=st.builds(Wish, width=st.integers(1, 400)),
)
PUBLISHES = st.builds(
    Publish,
    topic=TEXTS,
    fields=TEXTS,
    type_name=TEXTS,
    ticket=INTEGERS,
    rest=TEXTS,
    rest_after=st.floats(0, LONGEST_REST, exclude_min=True),
)
LIMITED: dict[Any, st.SearchStrategy[Any]] = {
    Viewed: VIEWED,
    LookAtTopics: LOOKS,
    EndLook: st.builds(EndLook, viewer=VIEWERS),
    Publish: PUBLISHES,
}
"""Types whose parts have limits."""


def made(kind: Any) -> st.SearchStrategy[Any]:
    """Any value of a type, by its hints."""
    if kind in LIMITED:
        return LIMITED[kind]
    if kind is Any:
        return st.one_of(TEXTS, INTEGERS, st.booleans(), st.none())
    if kind is msgspec.Raw:
        return made(RouteSnapshot).map(protocol.encode_route)
    if get_origin(kind) is Literal:
        return st.sampled_from(get_args(kind))
    if get_origin(kind) in (typing.Union, types.UnionType):
        return st.one_of([made(each) for each in get_args(kind)])
    if get_origin(kind) is tuple:
        return st.lists(made(get_args(kind)[0]), max_size=3).map(tuple)
    if get_origin(kind) is dict:
        return st.dictionaries(made(get_args(kind)[0]), made(get_args(kind)[1]), max_size=3)
    if isinstance(kind, type) and (dataclasses.is_dataclass(kind) or issubclass(kind, msgspec.Struct)):
        hints = typing.get_type_hints(kind)
        fields = {name: made(hint) for name, hint in hints.items() if get_origin(hint) is not typing.ClassVar}
        return st.builds(kind, **fields)
    plain = {int: INTEGERS, float: st.floats(allow_nan=False), str: TEXTS, bool: st.booleans(), type(None): st.none()}
    return plain[kind] if kind in plain else st.from_type(kind)


MESSAGES = {kind.__name__: made(kind) for kind in (*get_args(ToBridge), *get_args(ToConsole))}


def fed(data: bytes, cuts: list[int], *, to_bridge: bool) -> list[Any]:
    """The messages in `data`, which comes in pieces."""
    frames: protocol.Frames[Any] = protocol.frames_to_bridge() if to_bridge else protocol.frames_to_console()
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [each for begin, end in itertools.pairwise(edges) for each in frames.feed(data[begin:end])]


@pytest.mark.parametrize("name", MESSAGES)
@settings(max_examples=settings().max_examples // 3, deadline=None)
@given(data=st.data(), cuts=st.lists(st.integers(0, 10_000), max_size=5))
def test_every_message_comes_through_whole(name: str, data: st.DataObject, cuts: list[int]) -> None:
    messages = data.draw(st.lists(MESSAGES[name], min_size=1, max_size=3))
    to_bridge = name in {kind.__name__ for kind in get_args(ToBridge)}
    assert fed(b"".join(map(protocol.encode, messages)), cuts, to_bridge=to_bridge) == messages


@settings(max_examples=settings().max_examples * 3, deadline=None)
@given(data=st.binary(max_size=200), to_bridge=st.booleans())
def test_whatever_comes_is_a_message_or_refused(data: bytes, to_bridge: bool) -> None:
    with contextlib.suppress(ControlProtocolError):  # some bytes are a message
        fed(len(data).to_bytes(4, "big") + data, [], to_bridge=to_bridge)


@pytest.mark.parametrize(
    ("make", "limit"),
    [(protocol.frames_to_bridge, protocol.TO_BRIDGE_LIMIT), (protocol.frames_to_console, protocol.TO_CONSOLE_LIMIT)],
)
def test_a_frame_that_is_too_large_is_refused_before_it_is_kept(make: Any, limit: int) -> None:
    with pytest.raises(ControlProtocolError, match="at most"):
        list(make().feed((limit + 1).to_bytes(4, "big")))


def test_a_message_of_ten_thousand_levels_is_refused() -> None:
    body = b"\x91" * 10_000 + b"\x90"
    with pytest.raises(ControlProtocolError, match="invalid"):
        fed(len(body).to_bytes(4, "big") + body, [], to_bridge=True)


@pytest.mark.parametrize("to_bridge", [True, False])
def test_text_that_is_not_utf_8_is_refused(to_bridge: bool) -> None:
    message = protocol.ConsoleHello(1, "words") if to_bridge else protocol.HelloRefused("words")
    body = protocol.encode(message)[4:].replace(b"words", b"\xa6ords")
    with pytest.raises(ControlProtocolError, match="invalid"):
        fed(len(body).to_bytes(4, "big") + body, [], to_bridge=to_bridge)


@settings(max_examples=settings().max_examples // 2, deadline=None)
@given(data=st.data())
def test_a_console_has_the_routes_that_the_engine_has(data: st.DataObject) -> None:
    """After routes are added, changed, removed and moved between two polls."""
    engine, sender, encoded = ScriptedEngine(), Sender(), EncodedRoutes()
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
        states = fed(b"".join(wire), [], to_bridge=False)
        assert [receiver.take(state) for state in states] == [False] * (len(states) - 1) + [True]
        assert isinstance(states[-1], StateChange)
        assert receiver.snapshot == now
        assert receiver.session == session


def test_what_has_not_changed_is_not_sent_again() -> None:
    engine, sender, encoded = ScriptedEngine(), Sender(), EncodedRoutes()
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
