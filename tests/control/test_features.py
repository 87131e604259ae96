"""Bridges and consoles of different versions: messages that they do not exchange, and the operators' explanation."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, get_args

import msgspec
import pytest
from tests.console.scripted import LINK, SESSION, ScriptedEngine, route

from rsb_bridge.api import EngineError
from rsb_bridge.control import attached_console, control_sockets, protocol, remote_engine
from rsb_bridge.control.features import (
    ACKNOWLEDGE,
    COMMANDS,
    FEATURES,
    FIELDS,
    missing_feature,
    with_unknown_kept,
    without_unknown,
)
from rsb_bridge.control.protocol import State, decode_route
from rsb_bridge.model.benchmark import BenchmarkLimits
from rsb_bridge.model.commands import AddTopic, AnyCommand, ChangeClient, EditTopic
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Grant, Operator, Session, Topic, ZenohSettings
from rsb_bridge.model.snapshot import PatternSnapshot
from rsb_bridge.model.snapshot import State as RouteState

if TYPE_CHECKING:
    from concurrent.futures import Future

    from tests.support.control import Machine

    from rsb_bridge.control.remote_engine import RemoteEngine

FIRST_COMMANDS = {
    "add", "add_client", "arm", "bench", "call", "change_client", "describe", "disarm", "edit", "history", "keep_armed",
    "pause", "peek", "release_armed", "reload", "remove", "remove_client", "restart", "retry", "shut_down", "stop",
    "template", "topics",
}  # fmt: skip
"""The commands of the first version 1."""
FIRST_FIELDS: dict[type[msgspec.Struct], str] = {
    Topic: "topic direction type protocol port qos remote_topic compression max_rate expected_rate stale_after paused"
    " arm deadman kind timeout priority excepts",
    Grant: "topics services may protocol max_rate",
    Client: "name key_file next_key_file use_name allow deny topics profile bench group",
    ZenohSettings: "connect listen config fleet",
    Operator: "name key_file may",
    Session: "name role server_ip server_port bluetooth_address domain_id use_name use_encryption key_file"
    " next_key_file stale_after stale_warnings shutdown_topic diagnostics_topic metrics topics clients allow deny ports"
    " shared_keys profile bench zenoh operators group",
    BenchmarkLimits: "seconds max_rate megabytes",
    Qos: "reliability durability history depth deadline lifespan",
}
"""The fields of the first version 1 in what it refuses to read with an unknown field."""
FIRST_HELLO = bytes.fromhex("0000002183a26973a568656c6c6fa776657273696f6e01a770726f6772616da5302e312e30")
"""A console's greeting, recorded from the first version 1."""
FIRST_WELCOME = bytes.fromhex(
    "0000008082a26973a777656c636f6d65a662726964676588a46e616d65a6726f626f7431a4726f6c65a6636c69656e74a761646472657373"
    "af31302e302e302e32303a3439313532a370696401a773746172746564cb0000000000000000a8696e7374616e6365a178a770726f677261"
    "6da5302e312e30a466696c65a72f722e79616d6c"
)
"""A bridge's greeting, recorded in the same way."""
NOTHING: frozenset[str] = frozenset()
ALL = frozenset(FEATURES)


def test_each_new_command_and_field_has_a_feature() -> None:
    """Without one, the other side would end the connection: enter it in `rsb_bridge.control.features`."""
    tags = {kind.__struct_config__.tag for kind in get_args(AnyCommand)}
    assert {kind.__struct_config__.tag for kind in COMMANDS} == tags - FIRST_COMMANDS  # type: ignore[attr-defined]
    for kind, first in FIRST_FIELDS.items():
        assert set(FIELDS.get(kind, {})) == set(kind.__struct_fields__) - set(first.split()), kind
    assert {*COMMANDS.values(), *(feature for of in FIELDS.values() for feature in of.values())} <= ALL


# --- a console attached to an older bridge


@pytest.fixture
def older(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> tuple[ScriptedEngine, RemoteEngine]:
    """A bridge that names no features, and a console that is attached to it."""
    monkeypatch.setattr(attached_console, "FEATURES", ())
    engine = ScriptedEngine()
    machine.serve(engine)
    return engine, machine.attach()


def test_an_older_bridge_greets_without_features() -> None:
    (welcome,) = protocol.frames_to_console().feed(FIRST_WELCOME)
    assert isinstance(welcome, protocol.Welcome)
    assert welcome.features == ()


def fails(future: Future[Any], name: str) -> None:
    with pytest.raises(EngineError) as error:
        future.result(60)
    assert name in str(error.value)
    assert "update" in str(error.value)


def test_what_an_older_bridge_does_not_know_is_not_sent_to_it(older: tuple[ScriptedEngine, RemoteEngine]) -> None:
    engine, remote = older
    late = Topic("/scan", "receive", late_after=2.0)
    asked: list[Future[Any]] = [
        remote.acknowledge("/scan"),
        remote.acknowledge("", link="robot1"),
        remote.add_topic(late),
        remote.edit_topic("/scan", late),
        remote.change_client(Client("robot2", topics=(late,))),
    ]
    for future in asked:
        fails(future, engine.session.name)
    assert engine.commands == []
    remote.edit_topic("/scan", Topic("/scan", "receive")).result(60)
    remote.pause("/scan", True).result(60)
    assert [command[0] for command in engine.commands] == ["edit", "pause"]
    assert not remote.unreachable


def test_the_version_is_named_if_it_differs(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attached_console, "FEATURES", ())
    machine.serve()
    remote = machine.attach()
    assert remote.bridge.program not in str(remote.lacks(ACKNOWLEDGE))
    monkeypatch.setattr(remote_engine, "__version__", "9.0.0")
    assert remote.bridge.program in str(remote.lacks(ACKNOWLEDGE))


def test_a_bridge_of_this_version_gets_all(machine: Machine) -> None:
    engine = ScriptedEngine()
    machine.serve(engine)
    remote = machine.attach()
    assert remote.features == ALL
    remote.acknowledge("/scan").result(60)
    remote.add_topic(Topic("/more", "receive", late_after=2.0)).result(60)
    assert [command[0] for command in engine.commands] == ["acknowledge", "add"]


@pytest.mark.parametrize(
    ("command", "missing"),
    [
        (AddTopic(Topic("/a", "receive")), ""),
        (AddTopic(Topic("/a", "receive", late_after=0.0)), "late_after"),
        (
            ChangeClient(Client("a", topics=(Topic("/a", "receive"), Topic("/b", "receive", late_after=1.0)))),
            "late_after",
        ),
    ],
)
def test_a_command_needs_the_features_of_its_parts(command: AnyCommand, missing: str) -> None:
    assert missing_feature(command, NOTHING) == missing
    assert missing_feature(command, ALL) == ""


# --- an older console attached to a bridge

LATE_ENTRY = Topic("/scan", "transmit", late_after=2.0)
PATTERN = PatternSnapshot(
    "pattern", "robot1", Topic("/c/*", "transmit", late_after=3.0), RouteState.OK, "", True, "/c/*"
)
NEW_SESSION = msgspec.structs.replace(
    SESSION,
    late_after=4.0,
    on_fault="/bin/true",
    topics=(LATE_ENTRY, Topic("/odom", "transmit")),
    clients=(Client("robot2", topics=(LATE_ENTRY,)),),
)


class Greeted:
    """A raw console, and the messages that it gets after a greeting of its own."""

    def __init__(self, machine: Machine, hello: bytes) -> None:
        self.heard = b""
        with control_sockets.connect(machine.folder / "robot1.sock", 60.0) as connection:
            connection.sendall(hello + protocol.encode(protocol.PollState()))
            frames, self.messages = protocol.frames_to_console(), list[Any]()
            while not any(isinstance(each, State) for each in self.messages):
                data = connection.recv(1 << 16)
                assert data
                self.heard += data
                self.messages += frames.feed(data)

    @property
    def welcome(self) -> protocol.Welcome:
        found = self.messages[0]
        assert isinstance(found, protocol.Welcome)
        return found

    @property
    def state(self) -> State:
        return next(each for each in self.messages if isinstance(each, State))


@pytest.fixture
def newer(machine: Machine) -> Machine:
    """A machine whose bridge has a session with all that an older console does not know."""
    engine = ScriptedEngine(NEW_SESSION, routes=(route("/scan", spec=LATE_ENTRY), route("/odom")))
    engine.now = dataclasses.replace(engine.now, links=(dataclasses.replace(LINK, patterns=(PATTERN,)),))
    machine.serve(engine, file=machine.folder / "robot1.yaml")
    return machine


def test_an_older_console_is_not_sent_what_it_does_not_know(newer: Machine) -> None:
    told = Greeted(newer, FIRST_HELLO)
    for name in (b"late_after", b"on_fault"):
        assert name not in told.heard[len(protocol.encode(told.welcome)) :]
    assert told.welcome.bridge.file is None, "it would save the file without what it is not sent"
    session = told.state.session
    assert session is not None
    assert session == without_unknown(NEW_SESSION, NOTHING)
    assert (session.late_after, session.on_fault) == (SESSION.late_after, None)
    assert [topic.topic for topic in session.topics] == ["/scan", "/odom"]
    assert [decode_route(raw).topic for raw in told.state.routes] == ["/scan", "/odom"]
    assert told.state.links[0].patterns[0].spec.topic == "/c/*"


def test_a_console_of_this_version_is_sent_all_of_it(newer: Machine) -> None:
    Greeted(newer, FIRST_HELLO)  # what an older one was sent is not kept for others
    told = Greeted(newer, protocol.encode(protocol.Hello(protocol.VERSION, "0.1.0", features=FEATURES)))
    assert told.state.session == NEW_SESSION
    assert decode_route(told.state.routes[0]).spec == LATE_ENTRY
    assert told.state.links[0].patterns == (PATTERN,)
    assert told.welcome.bridge.file is not None
    assert told.welcome.features == FEATURES


def test_a_session_without_new_fields_is_sent_as_it_is(machine: Machine) -> None:
    machine.serve(file=machine.folder / "robot1.yaml")
    told = Greeted(machine, FIRST_HELLO)
    assert told.state.session == SESSION
    assert told.welcome.bridge.file is not None
    assert without_unknown(SESSION, NOTHING) is SESSION


def test_an_edit_by_an_older_console_keeps_what_it_does_not_know() -> None:
    engine = ScriptedEngine(NEW_SESSION, routes=(route("/scan", spec=LATE_ENTRY),))
    engine.now = dataclasses.replace(engine.now, links=(dataclasses.replace(LINK, patterns=(PATTERN,)),))
    key = engine.now.routes[0].key
    edited = Topic("/scan", "transmit", max_rate=5.0)

    def kept(command: AnyCommand, features: frozenset[str] = NOTHING) -> Any:
        return with_unknown_kept(command, features, engine.now, NEW_SESSION)

    assert kept(EditTopic(key, edited)).topic == msgspec.structs.replace(edited, late_after=2.0)
    assert kept(EditTopic(PATTERN.key, edited)).topic.late_after == 3.0
    assert kept(EditTopic(key, edited), ALL).topic == edited, "a console of this version has removed it"
    assert kept(EditTopic("gone", edited)).topic == edited
    client = Client("robot2", topics=(edited, Topic("/new", "transmit")))
    assert [topic.late_after for topic in kept(ChangeClient(client)).client.topics] == [2.0, None]
