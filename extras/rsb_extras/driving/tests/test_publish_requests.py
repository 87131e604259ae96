"""Commands that publish: on their way to a bridge, and late."""

import pytest
from tests.console.scripted import ScriptedEngine
from tests.control.late_requests_helpers import each_again, slow_line
from tests.control.protocol_helpers import fed
from tests.support import replaced
from tests.support.control import Machine
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.control import protocol
from rsb_bridge.control.protocol import RequestProblem
from rsb_bridge.model.by_hand import OLD_AFTER, TICKET_LIFE
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import Right
from rsb_extras.driving.publish_requests import DraftMessage, Publish


def test_they_come_through_whole() -> None:
    commands = (Publish("/t", "{x: 1}", "T", 5, "{}", 0.25, reduce=True), DraftMessage("/t", "T"))
    messages = [protocol.CommandRequest(number, command) for number, command in enumerate(commands)]
    assert fed(b"".join(map(protocol.encode, messages)), to_bridge=True) == messages


def test_who_may_look_may_not_publish() -> None:
    assert Publish.right is Right.CHANGE
    assert DraftMessage.right is Right.LOOK


def test_a_message_expires() -> None:
    assert Publish("/scan", "{}").expires
    assert not DraftMessage("/scan").expires


@pytest.mark.parametrize(("rest", "life"), [("", OLD_AFTER), ("{}", TICKET_LIFE)])
def test_refused_velocity_is_repeated_only_for_moment(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, rest: str, life: float
) -> None:
    """The console, or its connection to the bridge, hangs between the command and its refusal."""
    engine = ScriptedEngine()
    remote = machine.attach_to(engine)
    eventually(lambda: remote._ticket)
    now = [Clock.steady()]
    replaced.STEADY_CLOCK.set(monkeypatch, staticmethod(lambda: now[0]))

    def stand_still(_: object) -> None:
        now[0] += life + 0.1

    each_again(monkeypatch, stand_still)
    slow_line(remote, monkeypatch, TICKET_LIFE + 0.5)
    with pytest.raises(EngineError, match=pattern(RequestProblem.TOO_LATE)):
        remote.do(Publish("/scan", "{}", rest=rest)).result(60)
    assert engine.commands == []
    remote.pause("k", True).result(60)
    assert not any(event.code == EventCode.ATTACH_LOST for event in remote.events())
