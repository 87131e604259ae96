"""Commands of attached consoles that come late: what may move a robot is refused, and repeated only if still wanted."""

from __future__ import annotations

import inspect
import typing
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.scripted import ScriptedEngine
from tests.control.late_requests_helpers import each_again, slow_line
from tests.support import replaced
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.control.attached_console import TicketClock
from rsb_bridge.control.protocol import AnyCommand, RequestProblem
from rsb_bridge.model import commands
from rsb_bridge.model.by_hand import OLD_AFTER, TICKET_LIFE
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.commands import AnswerAsker, ArmTopic, AskHolder, Call, PauseTopics, TakeArming
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.control import Machine

    from rsb_bridge.model.commands import Command

MOVING: list[Command[Any]] = [
    ArmTopic("/scan"),
    AskHolder("/scan"),
    TakeArming("/scan"),
    AnswerAsker("/scan", gives=True),
    PauseTopics("/scan", paused=False),
    commands.EditTopic("/scan", Topic("/scan", "transmit")),
    commands.AddTopic(Topic("/scan", "transmit")),
    commands.RemoveTopic("/scan", drop_arm=True),
    commands.Retry(),
    commands.Restart(),
    commands.Reload(),
    Call("/scan", "{}"),
]


def test_a_ticket_has_an_age() -> None:
    now = [100.0]
    tickets = TicketClock(lambda: now[0])
    first = tickets.issue()
    now[0] += 1.5
    assert tickets.age(first) == pytest.approx(1.5, abs=0.002)
    assert tickets.age(tickets.issue()) == 0
    assert abs(TicketClock(lambda: now[0]).age(first)) > OLD_AFTER


def test_what_moves_a_robot_expires() -> None:
    assert all(each.expires for each in MOVING)
    scan = Topic("/scan", "transmit")
    paused = Topic("/scan", "transmit", paused=True)
    for harmless in (
        PauseTopics("/scan", paused=True),
        commands.AddTopic(paused),
        commands.EditTopic("/scan", paused),
        commands.EditTopic("/scan", Topic("/scan", "transmit", max_rate=5.0), seen=scan),
        commands.RemoveTopic("/scan"),
        commands.Reload(dry_run=True),
    ):
        assert not harmless.expires
    assert commands.EditTopic("/scan", scan, seen=paused).expires


def test_what_changes_a_bridge_states_its_effect() -> None:
    kinds: list[Any] = [kind for kind in typing.get_args(AnyCommand) if inspect.isclass(kind)]
    changing = [kind for kind in kinds if kind.right in (commands.Right.CHANGE, commands.Right.TAKE)]
    assert [kind for kind in changing if not {"always", "effect"} & vars(kind).keys()] == []


@pytest.mark.parametrize("command", MOVING, ids=lambda each: type(each).__name__)
@pytest.mark.parametrize("age", [0.0, TICKET_LIFE + 0.5, -60.0])
def test_old_ticket_costs_round_trip_command_runs_once(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, command: Command[Any], age: float
) -> None:
    engine = ScriptedEngine()
    remote = machine.attach_to(engine)
    slow_line(remote, monkeypatch, age)
    remote.do(command)
    eventually(lambda: engine.commands)
    remote.do(PauseTopics("/scan", paused=True)).result(60)
    assert [each[0] for each in engine.commands][1:] == ["pause"]


@pytest.mark.parametrize("command", MOVING, ids=lambda each: type(each).__name__)
def test_old_command_is_not_sent(machine: Machine, command: Command[Any]) -> None:
    engine = ScriptedEngine()
    remote = machine.attach_to(engine)
    remote.given_at = Clock.steady() - OLD_AFTER - 0.1
    with pytest.raises(EngineError, match=pattern(RequestProblem.TOO_LATE)):
        remote.do(command).result(60)
    remote.do(PauseTopics("/scan", paused=True)).result(60)
    assert [each[0] for each in engine.commands] == ["pause"]


def test_abandoned_refused_command_is_not_repeated(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = ScriptedEngine()
    remote = machine.attach_to(engine)
    each_again(monkeypatch, lambda waiting: waiting.future.cancel())
    slow_line(remote, monkeypatch, TICKET_LIFE + 0.5)
    eventually(remote.do(ArmTopic("/scan")).cancelled)
    remote.do(PauseTopics("/scan", paused=True)).result(60)
    assert [each[0] for each in engine.commands] == ["pause"]


def test_refused_command_is_repeated_only_while_wanted(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """The console, or its connection to the bridge, hangs between the command and its refusal."""
    engine = ScriptedEngine()
    remote = machine.attach_to(engine)
    eventually(lambda: remote._ticket)
    now = [Clock.steady()]
    replaced.STEADY_CLOCK.set(monkeypatch, staticmethod(lambda: now[0]))

    def stand_still(_: object) -> None:
        now[0] += OLD_AFTER + 0.1

    each_again(monkeypatch, stand_still)
    slow_line(remote, monkeypatch, TICKET_LIFE + 0.5)
    with pytest.raises(EngineError, match=pattern(RequestProblem.TOO_LATE)):
        remote.do(Call("/scan", "{}")).result(60)
    assert engine.commands == []
