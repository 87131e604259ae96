"""A bridge in the instruments of ROS, such as rqt_robot_monitor."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from tests.engine.reloading_helpers import Edited
from tests.support.bridge import carries, find, happened, link, linked, route
from tests.support.domain import LATCHED
from tests.support.waiting import eventually
from tests.support.wording import pattern, says

from rsb_bridge.api import EngineError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import acting
from rsb_bridge.model.session import Client, Topic
from rsb_extras.exporters import DRIVER_TOPIC
from rsb_extras.exporters.exporter_codes import ExporterCode
from rsb_extras.exporters.ros_topics import DriverTopicText
from rsb_extras.exporters.tests import exporter_places

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
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
    server = bridge.server(features={"diagnostics_topic": "/health"})
    eventually(lambda: _status(health, LINK))
    file = Edited(server, tmp_path / "server.yaml")
    assert file.reload(features={"diagnostics_topic": None}).changed == ("diagnostics_topic /health → none",)
    eventually(lambda: not health.matched)


def test_pattern_takes_it_once_a_node_publishes_there(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    there = pc.listener("/diagnostics", DiagnosticArray)
    server, client = bridge.both(Topic("/**", "transmit"))
    robot.publisher("/scan")
    eventually(lambda: find(client, "/scan"))
    assert find(client, "/diagnostics") is None
    driver = robot.publisher("/diagnostics", DiagnosticArray)
    eventually(lambda: find(server, "/diagnostics"))

    def hears_driver() -> bool:
        driver.publish(DiagnosticArray(status=[DiagnosticStatus(name="motor: warm")]))
        arrays = (deserialize_message(payload, DiagnosticArray) for payload in there.payloads)
        return any(status.name == "motor: warm" for array in arrays for status in array.status)

    eventually(hears_driver)


def test_a_type_that_is_missing_ends_nothing_else(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    exporter_places.DIAGNOSTICS_TYPE.set(monkeypatch, "no_msgs/msg/None")
    server, client = bridge.both()
    for engine in (server, client):
        assert happened(engine, ExporterCode.DIAGNOSTICS)


def _held(listener: Listener) -> list[dict[str, object]] | None:
    """The holders of topics in the newest message."""
    if not (payloads := listener.payloads):
        return None
    found: list[dict[str, object]] = json.loads(deserialize_message(payloads[-1], String).data)
    return found


@pytest.mark.usefixtures("long_lease")
def test_nodes_hear_who_holds_which_topic(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    """On both sides; latched, for late subscribers."""
    here, there = robot.listener("/rsb/driver", qos=LATCHED), pc.listener("/rsb/driver", qos=LATCHED)
    server, client = bridge.both(
        Topic("/cmd", "receive", arm=True, deadman=0.0), features={"driver_topic": "/rsb/driver"}
    )
    eventually(lambda: (_held(here), _held(there)) == ([], []))
    eventually(lambda: route(server, "/cmd").state == route(client, "/cmd").state == "disarmed")
    with acting("anna"):
        consoles.arm(server)
    holds_it = {"topic": "/cmd", "link": "robot1", "holder": "anna", "here": True}
    eventually(lambda: _held(there) == [holds_it])
    eventually(lambda: _held(here) == [holds_it | {"holder": "server says: anna", "here": False}])
    late = pc.listener("/rsb/driver", qos=LATCHED)
    eventually(lambda: _held(late) == [holds_it])
    server.disarm(route(server, "/cmd").key).result(30)
    eventually(lambda: (_held(here), _held(there)) == ([], []))
    assert len(there.payloads) == 3


def test_reload_begins_topic_of_holders(bridge: Bridge, pc: Domain, tmp_path: Path) -> None:
    listener = pc.listener("/held", qos=LATCHED)
    server = bridge.server()
    assert DRIVER_TOPIC.of(server.session) is None
    file = Edited(server, tmp_path / "server.yaml")
    assert file.reload(features={"driver_topic": "/held"}).changed == ("driver_topic none → /held",)
    eventually(lambda: _held(listener) == [])
    assert file.reload(features={}).changed == ("driver_topic /held → none",)
    eventually(lambda: not listener.matched)


@pytest.mark.parametrize("side", ["server", "client"])
def test_topic_of_holders_is_bridged_by_neither_side(bridge: Bridge, side: str) -> None:
    """A topic that is added while the bridge runs, and one that the other side proposes: both get the reason."""
    own: dict[str, Any] = {side: {"features": {"driver_topic": "/rsb/driver"}}}
    server = bridge.server(clients=(Client("robot1"),), **own.get("server", {}))
    client = bridge.client(allow=("/**",), **own.get("client", {}))
    eventually(lambda: linked(server) and linked(client))
    has_it, other = (server, client) if side == "server" else (client, server)
    entry = Topic("/rsb/driver", "transmit", type="std_msgs/msg/String")
    with pytest.raises(EngineError, match=pattern(DriverTopicText.REFUSED, topic="/rsb/driver")):
        has_it.add_topic(entry).result(30)
    other.add_topic(entry).result(30)
    eventually(lambda: says(route(other, "/rsb/driver").reason, DriverTopicText.REFUSED, topic="/rsb/driver"))
    assert happened(has_it, EventCode.ROUTE_REFUSED)
    assert find(has_it, "/rsb/driver") is None


def test_reload_onto_bridged_topic_publishes_no_holders(bridge: Bridge, pc: Domain, tmp_path: Path) -> None:
    listener = pc.listener("/held", qos=LATCHED)
    server, client = bridge.both(Topic("/held", "transmit", type="std_msgs/msg/String"))
    eventually(lambda: find(server, "/held"))
    Edited(server, tmp_path / "server.yaml").reload(features={"driver_topic": "/held"})
    eventually(lambda: happened(server, ExporterCode.DIAGNOSTICS, DriverTopicText.BRIDGED, link="robot1"))
    client.remove_topic(route(client, "/held").key).result(30)
    eventually(lambda: _held(listener) == [])


def test_topic_of_holders_with_foreign_type_waits(bridge: Bridge, pc: Domain) -> None:
    pc.listener("/rsb/driver", Twist)
    server = bridge.server(features={"driver_topic": "/rsb/driver"})
    text, types = DriverTopicText.OTHER_TYPE, "geometry_msgs/msg/Twist"
    eventually(lambda: happened(server, ExporterCode.DIAGNOSTICS, text, types=types))
    pc.clear()
    listener = pc.listener("/rsb/driver", qos=LATCHED)
    eventually(lambda: _held(listener) == [])
