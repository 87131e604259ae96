"""The parameters of many nodes: one subscription brings their events, each to its own route."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rcl_interfaces.msg import ParameterEvent
from rclpy.qos import qos_profile_parameter_events
from rclpy.serialization import deserialize_message
from tests.calls.ledgers import counts
from tests.support.bridge import now
from tests.support.crowd import Crowd
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

NODES = 12
WITHIN = 400.0


def _subscriptions(domain: Domain) -> int:
    """Return the bridges' subscriptions, without those of rclpy's nodes."""
    found = domain.node.get_subscriptions_info_by_topic("/parameter_events")
    return sum(each.node_name.startswith("rsb_robot1") for each in found)


def test_the_events_of_many_nodes_come_by_one_subscription_each_to_its_own_route(
    bridge: Bridge, robot: Domain, pc: Domain
) -> None:
    crowd = Crowd(robot.id, "node", NODES)
    try:
        _, client = bridge.both(
            *(Topic(f"/node{number}", "receive", kind="parameters") for number in range(NODES)), use_name=True
        )
        listener = pc.listener("/parameter_events", ParameterEvent, qos_profile_parameter_events)

        def values() -> dict[str, list[int]]:
            found: dict[str, list[int]] = {}
            for payload in listener.payloads:
                event = deserialize_message(payload, ParameterEvent)
                for changed in event.changed_parameters:
                    found.setdefault(event.node, []).append(changed.value.integer_value)
            return found

        def all_offered() -> bool:
            stages = [stage for route in now(client).routes for stage in route.stages if stage.name == "offered"]
            return len(stages) == NODES and all(stage.done for stage in stages)

        eventually(all_offered, WITHIN, "all nodes' parameters are offered")
        eventually(lambda: _subscriptions(robot) == 1)
        eventually(lambda: listener.matched >= NODES, WITHIN, "the listener knows all publishers")
        names = [f"/robot1/node{number}" for number in range(NODES)]
        rounds = 0

        def all_come() -> bool:
            nonlocal rounds
            rounds += 1
            for number in range(NODES):
                crowd.set(number, -rounds)
            return values().keys() == set(names)

        eventually(all_come, WITHIN, "an event of each node")
        for number in range(NODES):
            crowd.set(number, 1000 + number)
            crowd.set(number, 2000 + number)
        wanted = {name: [1000 + number, 2000 + number] for number, name in enumerate(names)}
        eventually(
            lambda: {name: [each for each in found if each > 0] for name, found in values().items()} == wanted,
            WITHIN,
            "each node's own two events, once",
        )
        assert _subscriptions(robot) == 1
        assert counts(client, "/node0").asked == 0

        for topic in [route.key for route in now(client).routes][1:]:
            client.remove_topic(topic).result(60)
        left = now(client).routes[0].topic.removeprefix("/node")
        crowd.set(int(left), 5000)
        eventually(lambda: values()[f"/robot1/node{left}"][-1] == 5000)
        assert _subscriptions(robot) == 1
        client.remove_topic(now(client).routes[0].key).result(60)
        eventually(lambda: _subscriptions(robot) == 0)
    finally:
        crowd.close()
