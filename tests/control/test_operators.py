"""Operators attach over a network: who gets in, what they may do, and what strangers can do there."""

from __future__ import annotations

import hashlib
import os
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.scripted import ScriptedEngine, route
from tests.support import replaced
from tests.support.operators import ANNA, BOB, Reachable, granted
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.config.keys import Key
from rsb_bridge.config.session_file import save
from rsb_bridge.control.attached_console import RequestRefused
from rsb_bridge.control.control_sockets import user_name
from rsb_bridge.control.remote_engine import attach
from rsb_bridge.engine.access import Access
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import account
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.wire.connection import RECORD_CONTENT

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.control import Machine

    from rsb_bridge.control.sealed import SealedConsole


def test_an_operator_attaches_and_changes(reachable: Reachable) -> None:
    remote = reachable.attach()
    assert not remote.read_only
    assert [each.topic for each in remote.snapshot().routes] == [
        each.topic for each in reachable.engine.snapshot().routes
    ]
    remote.retry().result(60)
    (came,) = reachable.events(EventCode.ATTACH_OPERATOR)
    assert came.who.startswith("anna (operator key)")
    remote.stop()
    eventually(lambda: reachable.events(EventCode.ATTACH_OPERATOR_LEFT))


class Noting(ScriptedEngine):
    """Notes whose commands it gets."""

    def __init__(self) -> None:
        super().__init__()
        self.accounts: list[str] = []

    def _execute(self, command: Any, step: Any) -> Any:
        self.accounts.append(account())
        return super()._execute(command, step)


def test_a_key_or_user_is_an_account(machine: Machine) -> None:
    """Names are no accounts: they may be equal, or look as if they were."""
    me, engine, access = user_name(os.getuid()), Noting(), Access("robot1", EventLog(Clock()), Clock())
    keys = {"anna (day shift)": ANNA, "anna (night shift)": BOB, me: Key(hashlib.sha256(b"me").digest())}
    access.grant({name: entry for each, key in keys.items() for name, entry in granted(each, key).items()})
    reachable = Reachable(machine, engine, access)
    for name, key in [*keys.items(), *keys.items()]:
        remote = reachable.attach(name, key)
        remote.retry().result(60)
        remote.stop()
    machine.attach().retry().result(60)
    assert engine.accounts[:3] == engine.accounts[3:6]
    assert len(set(engine.accounts)) == 4
    assert all(engine.accounts)


def test_a_long_message_goes_record_by_record(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over Zenoh nothing of it would come before all of it: the console would call the bridge silent."""
    lengths: list[int] = []
    connected = replaced.CONSOLE_CONNECTED.value

    def measured(console: SealedConsole, transport: Any) -> None:
        write = transport.write

        def measure(data: bytes) -> None:
            lengths.append(len(data))
            write(data)

        transport.write = measure
        connected(console, transport)

    replaced.CONSOLE_CONNECTED.set(monkeypatch, measured)
    engine = ScriptedEngine(routes=tuple(route(f"/{number}") for number in range(50)))
    Reachable(machine, engine).attach()
    assert max(lengths) < 2 * RECORD_CONTENT < sum(lengths)


def test_only_who_may_take_takes_arming_without_asking(reachable: Reachable) -> None:
    """Others ask its holder."""
    anna = reachable.attach()
    anna.ask_holder("/cmd_vel").result(60)
    assert not anna.may_take
    with pytest.raises(EngineError, match=pattern(RequestRefused.ASKS_FIRST)):
        anna.take_arming("/cmd_vel").result(60)
    with pytest.raises(EngineError, match=pattern(RequestRefused.READ_ONLY)):
        reachable.attach("bob", BOB).take_arming("/cmd_vel").result(60)
    reachable.access.grant(granted("anna", ANNA, "take"))
    anna.stop()
    anna = reachable.attach()
    assert not anna.read_only
    assert anna.may_take
    anna.take_arming("/cmd_vel").result(60)
    given = [command for command in reachable.engine.commands if command != ("release",)]
    assert given == [("ask_holder", "/cmd_vel"), ("take_arming", "/cmd_vel")]


@pytest.mark.parametrize(
    ("name", "key", "engine", "code"),
    [
        ("anna", BOB, "robot1", EventCode.ATTACH_WRONG_KEY),
        ("carl", ANNA, "robot1", EventCode.ATTACH_UNKNOWN_NAME),
        ("anna", ANNA, "robot2", EventCode.ATTACH_UNKNOWN_NAME),
    ],
)
def test_missing_right_is_told_on_both_sides(
    reachable: Reachable, name: str, key: Key, engine: str, code: EventCode
) -> None:
    with pytest.raises(EngineError) as refused:
        reachable.attach(name, key, engine=engine)
    (event,) = reachable.events(code)
    assert repr(name if engine == "robot1" else engine) in str(refused.value)
    assert repr(name if engine == "robot1" else engine) in event.text
    assert reachable.server.attached() == 0


def test_file_of_other_machine_is_told_apart(machine: Machine, tmp_path: Path) -> None:
    here = tmp_path / "robot1.yaml"
    save(ScriptedEngine().session, here)
    robot = Reachable(machine, file=here)
    remote = attach(robot.way(), read_only=True)
    remote.stop()
    assert remote.read_only
    assert remote.bridge.file == str(here)
    assert remote.file_here is None
