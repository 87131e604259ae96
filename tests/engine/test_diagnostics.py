"""A bridge in the instruments of ROS, such as rqt_robot_monitor."""

from __future__ import annotations

from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.serialization import deserialize_message
from tests.engine.test_reloading import Edited
from tests.support import constants
from tests.support.bridge import carries, happened, link, linked
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from pathlib import Path

    import pytest
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener

LINK, SENT, TAKEN = "rsb robot1: link robot1", "rsb robot1: /chat to robot1", "rsb robot1: /chat from robot1"
OK, ERROR = DiagnosticStatus.OK, DiagnosticStatus.ERROR


def _status(listener: Listener, name: str) -> DiagnosticStatus | None:
    """The newest of that name."""
    if not (payloads := listener.payloads):
        return None
    array = deserialize_message(payloads[-1], DiagnosticArray)
    assert array.header.stamp.sec
    return next((status for status in array.status if status.name == name), None)


def _level(listener: Listener, name: str) -> bytes | None:
    found = _status(listener, name)
    return found.level if found is not None else None


def _value(listener: Listener, name: str, key: str) -> str | None:
    found = _status(listener, name)
    return next((each.value for each in found.values if each.key == key), None) if found is not None else None


def test_each_side_tells_the_instruments_of_its_domain(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    here, there = robot.listener("/diagnostics", DiagnosticArray), pc.listener("/diagnostics", DiagnosticArray)
    chat, out = pc.listener("/chat"), robot.publisher("/chat")
    server, client = bridge.both(Topic("/chat", "transmit"))
    eventually(lambda: chat.matched)
    carries([out], server, ["/chat"])
    eventually(lambda: _level(here, LINK) == OK and _level(here, SENT) == OK)
    eventually(lambda: _level(there, LINK) == OK and _level(there, TAKEN) == OK)
    eventually(lambda: _value(there, TAKEN, "type") == "std_msgs/msg/String")  # one that still opens is OK, too
    client.stop()
    eventually(lambda: not linked(server))
    eventually(lambda: _level(there, LINK) == ERROR and _level(there, TAKEN) == ERROR)
    found = _status(there, LINK)
    assert found is not None
    assert found.message == link(server).reason


def test_a_robots_diagnostics_cross_as_any_topic(bridge: Bridge, pc: Domain) -> None:
    """They include the diagnostics of the bridge itself."""
    there = pc.listener("/diagnostics", DiagnosticArray)
    bridge.both(Topic("/diagnostics", "transmit"))

    def told() -> bool:
        arrays = (deserialize_message(payload, DiagnosticArray) for payload in there.payloads)
        return any(status.name == "rsb robot1: /diagnostics to robot1" for array in arrays for status in array.status)

    eventually(told)


def test_on_another_topic_and_on_none(bridge: Bridge, pc: Domain, tmp_path: Path) -> None:
    health = pc.listener("/health", DiagnosticArray)
    server = bridge.server(diagnostics_topic="/health")
    eventually(lambda: _status(health, LINK))
    file = Edited(server, tmp_path / "server.yaml")
    assert file.reload(diagnostics_topic=None).changed == ("diagnostics_topic /health → none",)
    eventually(lambda: not health.matched)


def test_a_type_that_is_missing_ends_nothing_else(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.DIAGNOSTICS_TYPE.set(monkeypatch, "no_msgs/msg/None")
    server, client = bridge.both()
    for engine in (server, client):
        assert happened(engine, EventCode.ENGINE_DIAGNOSTICS)
