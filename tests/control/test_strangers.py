"""Attacks of strangers, and of operators who break the rules, where operators attach over a network."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import threading
import weakref
from typing import TYPE_CHECKING, get_args

import pytest
from tests.control.strangers_helpers import CHANGES
from tests.support import constants, replaced
from tests.support.operators import ANNA, BOB, Reachable, Stranger, granted
from tests.support.waiting import eventually, holds
from tests.wire.links import make_client

from rsb_bridge.config.keys import Key
from rsb_bridge.control import sealed
from rsb_bridge.control.protocol import (
    CONSOLES,
    AnyCommand,
    CommandFailed,
    CommandRequest,
    ConsoleHello,
    HelloRefused,
    PollState,
    encode,
)
from rsb_bridge.link.pending_connections import ConnectionStage
from rsb_bridge.model import commands
from rsb_bridge.model.budgets import CONNECTION, Strangers
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import Right
from rsb_bridge.wire import events
from rsb_bridge.wire.connection import OperatorConsole

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.control import Machine

    from rsb_bridge.config.operator_keys import Granted

CONNECTIONS, OPERATORS = 32, 24  # docs/budgets.md, of operators over a network


@pytest.mark.parametrize("read_only", [True, False])
def test_read_only_operator_is_refused_every_change(reachable: Reachable, machine: Machine, read_only: bool) -> None:
    of_core = [each for each in get_args(AnyCommand) if each.__module__ == commands.__name__]
    assert {type(each) for each in CHANGES} == {each for each in of_core if each.right in (Right.CHANGE, Right.TAKE)}
    with Stranger(reachable.port, "bob", BOB) as bob:
        bob.attach(read_only=read_only)
        for number, command in enumerate(CHANGES):
            bob.say(CommandRequest(number, command))
            answer = bob.answer()
            assert isinstance(answer, CommandFailed)
            assert answer.id == number
    assert reachable.engine.commands == []
    assert machine.stopped == 0


def test_thousand_attempts_leave_short_log_and_room(reachable: Reachable) -> None:
    remote = reachable.attach()
    for number in range(1000):
        with Stranger(reachable.port, f"guess{number}", Key(number.to_bytes(32, "big"))) as stranger:
            stranger.send(stranger.console.start())
    refused = (EventCode.ATTACH_UNKNOWN_NAME, EventCode.ATTACH_WRONG_KEY, EventCode.ATTACH_REJECTED)
    eventually(lambda: reachable.events(*refused))
    reachable.attach("bob", BOB)
    assert len(reachable.events(*refused)) <= 10
    assert not remote.unreachable
    remote.retry().result(60)


def test_many_failures_are_answered_late(reachable: Reachable, monkeypatch: pytest.MonkeyPatch) -> None:
    delays: list[float] = []
    real = replaced.REFUSAL_DELAY.value

    def delay(refusals: object, host: str) -> float:
        delays.append(real(refusals, host))
        return delays[-1]

    replaced.REFUSAL_DELAY.set(monkeypatch, delay)
    for _ in range(6):
        with Stranger(reachable.port, key=BOB) as stranger:
            stranger.send(stranger.console.start())
            (refused,) = stranger.hear()
            assert isinstance(refused, events.StreamRefused)
    assert delays == [0.0] * 4 + [1.0] * 2


def test_who_says_nothing_is_closed_in_time(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.SERVER_HANDSHAKE_WITHIN.set(monkeypatch, 0.0)
    robot = Reachable(machine)
    with Stranger(robot.port) as silent:
        assert silent.is_closed()
    assert robot.events(EventCode.ATTACH_REJECTED)


def test_who_has_no_confirmation_is_closed_in_time(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.SERVER_HANDSHAKE_WITHIN.set(monkeypatch, 0.2)
    robot = Reachable(machine)
    with Stranger(robot.port) as recorded:
        recorded.send(recorded.console.start())
        assert recorded.is_closed()
    assert robot.server.attached() == 0
    assert robot.events(EventCode.ATTACH_OPERATOR) == []


def test_many_who_say_nothing_keep_nobody_out(reachable: Reachable) -> None:
    with contextlib.ExitStack() as silent:
        first = silent.enter_context(Stranger(reachable.port))
        for _ in range(CONNECTIONS):
            silent.enter_context(Stranger(reachable.port))
        assert first.is_closed()
        reachable.attach()


def test_a_first_message_that_was_recorded_is_refused(reachable: Reachable) -> None:
    with Stranger(reachable.port) as anna:
        first = anna.console.start()
        anna.send(first)
        assert anna.hear() == [events.Admitted()]
        with Stranger(reachable.port) as replaying:
            replaying.send(first)
            assert replaying.is_closed()
    (refused,) = reachable.events(EventCode.ATTACH_REJECTED)
    assert "anna" in refused.text


def test_links_key_and_first_message_are_useless(reachable: Reachable) -> None:
    with Stranger(reachable.port) as link:
        link.send(make_client(key=ANNA.secret).start())
        assert link.is_closed()
    assert reachable.events(EventCode.ATTACH_REJECTED)
    assert reachable.server.attached() == 0


@pytest.mark.parametrize(
    "damage", [lambda record: record[:-1] + bytes((record[-1] ^ 1,)), lambda record: record + record]
)
def test_what_was_changed_on_way_ends_connection(reachable: Reachable, damage: Callable[[bytes], bytes]) -> None:
    with Stranger(reachable.port) as anna:
        anna.attach()
        record = anna.console.send(b"\0\0\0\1")
        anna.send(damage(record))
        assert anna.is_closed()
    eventually(lambda: reachable.server.attached() == 0)
    assert reachable.events(EventCode.ATTACH_REJECTED)


def test_operator_who_does_not_speak_protocol_is_closed(reachable: Reachable) -> None:
    with Stranger(reachable.port) as anna:
        anna.attach()
        anna.send(anna.console.send(b"\xff\xff\xff\xff"))
        assert anna.is_closed()
    eventually(lambda: reachable.server.attached() == 0)


def test_who_hears_only_is_closed(reachable: Reachable) -> None:
    with Stranger(reachable.port) as anna:
        anna.attach()
        anna.socket.shutdown(socket.SHUT_WR)
        assert anna.is_closed()
    eventually(lambda: reachable.events(EventCode.ATTACH_OPERATOR_LEFT))


def test_operators_leave_places_to_this_machine_s_consoles(reachable: Reachable, machine: Machine) -> None:
    with contextlib.ExitStack() as attached:
        for _ in range(OPERATORS):
            attached.enter_context(Stranger(reachable.port)).attach()
        one_more = attached.enter_context(Stranger(reachable.port))
        one_more.send(one_more.console.start())
        assert one_more.hear() == [events.Admitted()]
        one_more.say(ConsoleHello(1, "0.1.0"))
        assert isinstance(one_more.answer(), HelloRefused)
        for _ in range(CONSOLES - OPERATORS):
            machine.attach()


def test_replayed_first_messages_leave_room_for_others(reachable: Reachable) -> None:
    """A restarted engine has forgotten the recorded ones, and accepts each once."""
    with contextlib.ExitStack() as played:
        first = played.enter_context(Stranger(reachable.port))
        first.send(first.console.start())
        eventually(
            lambda: [each for each in reachable.acceptor.pending.present if each.stage is ConnectionStage.ACCEPTED]
        )
        for _ in range(OPERATORS):
            one = played.enter_context(Stranger(reachable.port))
            one.send(one.console.start())
        assert first.is_closed()
        assert len(reachable.acceptor.pending.present) <= OPERATORS
        reachable.attach("bob", BOB)


class Stalled:
    """A stream that takes nothing."""

    def __init__(self) -> None:
        self.waits = bytearray()
        self.aborted = threading.Event()

    def write(self, data: bytes) -> None:
        self.waits += data

    def get_write_buffer_size(self) -> int:
        return len(self.waits)

    def get_extra_info(self, name: str) -> str:
        return f"a stream without a {name}"

    def is_closing(self) -> bool:
        return self.aborted.is_set()

    def abort(self) -> None:
        self.aborted.set()

    def close(self) -> None:
        """Wait until everything is taken, for ever."""


def test_an_operator_who_takes_nothing_is_given_up(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.CONSOLE_STALLED_FOR.set(monkeypatch, 0.5)
    robot = Reachable(machine)
    stream, anna = Stalled(), Stranger(robot.port)

    async def attach() -> None:
        serving = robot.acceptor.protocol()
        serving.connection_made(stream)  # type: ignore[arg-type]
        serving.data_received(anna.console.start())
        anna.console.receive_data(bytes(stream.waits))
        stream.waits.clear()
        serving.data_received(anna.console.data_to_send())
        for message in (ConsoleHello(1, "0.1.0"), PollState()):
            serving.data_received(anna.console.send(encode(message)))

    with anna:
        asyncio.run_coroutine_threadsafe(attach(), robot.server.loop).result(60)
        assert stream.aborted.wait(60)
    eventually(lambda: robot.server.attached() == 0)


def test_a_refusal_that_nobody_takes_is_given_up(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.REFUSAL_TOLD_WITHIN.set(monkeypatch, 0.1)
    robot = Reachable(machine)
    stream = Stalled()

    async def fail() -> None:
        serving = robot.acceptor.protocol()
        serving.connection_made(stream)  # type: ignore[arg-type]
        serving.data_received(b"GET / HTTP/1.1\r\n\r\n")

    asyncio.run_coroutine_threadsafe(fail(), robot.server.loop).result(60)
    assert stream.aborted.wait(60)


@pytest.mark.parametrize(
    "now",
    [granted("anna", BOB), granted("anna", ANNA, "look"), {}],
    ids=["another key", "other rights", "removed"],
)
def test_a_reload_detaches_whom_it_is_about(reachable: Reachable, now: dict[str, Granted]) -> None:
    with Stranger(reachable.port) as anna, Stranger(reachable.port) as halfway:
        anna.attach()
        halfway.send(halfway.console.start())
        halfway.console.receive_data(halfway.socket.recv(4096))
        reachable.access.grant(now)
        assert anna.is_closed()
        assert halfway.is_closed(), "what it proves counts no more"
    eventually(lambda: reachable.server.attached() == 0)


def test_who_comes_when_bridge_has_ended_is_closed(reachable: Reachable) -> None:
    remote = reachable.attach()
    reachable.close()
    reachable.server.close("the bridge was stopped")
    lost = eventually(lambda: next((e for e in remote.events() if e.code == EventCode.ATTACH_LOST), None))
    assert "the bridge was stopped" in lost.text
    holds(lambda: remote.unreachable == "the bridge was stopped", 1.2)  # and two refused connections later


@pytest.mark.usefixtures("no_collector")
def test_refused_console_is_freed_at_once(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    connection_made, made = sealed.SealedConsole.connection_made, list[weakref.ref[object]]()

    def record(self: sealed.SealedConsole, transport: asyncio.BaseTransport) -> None:
        connection_made(self, transport)
        made.extend(map(weakref.ref, (self, self._machine, transport)))

    replaced.CONSOLE_CONNECTED.set(monkeypatch, record)
    robot = Reachable(machine)
    unknown = OperatorConsole("nobody", ANNA.secret, "robot1", version=1).start()
    said = (b"GET / HTTP/1.1\r\n\r\n", unknown, bytes(100_000), b"")
    for each in said:
        with Stranger(robot.port) as stranger:
            stranger.socket.sendall(each)
            with contextlib.suppress(OSError):  # it may be closed already
                stranger.socket.shutdown(socket.SHUT_WR)
            assert stranger.is_closed()
    with Stranger(robot.port) as stranger:
        eventually(lambda: len(made) == 3 * (len(said) + 1), what="all have come")
        stranger.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # it resets
    eventually(lambda: not any(each() for each in made), what="freed")
    assert robot.access.strangers.used == 0


def test_an_attached_operator_is_no_stranger(reachable: Reachable) -> None:
    with Stranger(reachable.port) as anna, Stranger(reachable.port) as silent:
        anna.attach()
        eventually(lambda: reachable.access.strangers.used == CONNECTION)
        del silent


def test_spent_budget_of_strangers_keeps_no_operator_out(reachable: Reachable) -> None:
    reachable.acceptor.pending.strangers = Strangers(3 * CONNECTION)
    with contextlib.ExitStack() as silent:
        first = silent.enter_context(Stranger(reachable.port))
        for _ in range(5):
            silent.enter_context(Stranger(reachable.port))
        assert first.is_closed()
        reachable.attach()
    assert reachable.acceptor.pending.strangers.turned_away >= 3
