"""Several bridges that mirror nodes: none mirrors a mirrored one, and no message goes round."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
import rclpy
from tests.engine.loops_helpers import DEEP, Pair, new_domain
from tests.support import constants
from tests.support.bridge import link, linked, route
from tests.support.ports import free_port
from tests.support.waiting import eventually
from tests.support.wording import has_text

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_extras.mirrored_nodes import MIRRORED, GraphKeys, MirrorCount
from rsb_extras.mirrored_nodes.mirror_table import NotMirrored
from rsb_extras.mirrored_nodes.tests.far_program import CAMERA, LIDAR, FarProgram

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bridges get as long as a slow machine takes to announce the origin of messages."""
    constants.EXPLAINED_WITHIN.set(monkeypatch, 30.0)


@pytest.fixture
def robot(_domains: int) -> Iterator[Domain]:
    yield from new_domain(_domains)


@pytest.fixture
def pc(_domains: int) -> Iterator[Domain]:
    yield from new_domain(_domains + 1)


def mirroring(bridge: Bridge, name: str, here: Domain, there: Domain) -> Pair:
    """A bridge of the scan, both ways. Both of its sides mirror the other one's nodes."""
    changes: dict[str, Any] = {"name": name, "server_port": free_port()}
    changes["features"] = {"graph": GraphKeys(nodes=True)}
    topics = [Topic("/scan", each, qos=DEEP) for each in ("transmit", "receive")]
    server = bridge.start(bridge.server_session(domain_id=there.id, **changes))
    client = bridge.start(bridge.client_session(*topics, domain_id=here.id, **changes))
    eventually(lambda: linked(client, name) and linked(server, name), what="linked")
    return Pair(server, client)


def names(domain: Domain) -> list[str]:
    found = domain.node.get_node_names_and_namespaces()
    return sorted(f"{namespace.rstrip('/')}/{name}" for name, namespace in found)


def stands(domain: Domain, name: str) -> Any:
    return rclpy.create_node(name, context=domain.context, start_parameter_services=False)


def test_nodes_of_the_first_domain_do_not_reach_the_third(
    bridge: Bridge, far: FarProgram, robot: Domain, pc: Domain, third: Domain
) -> None:
    mirroring(bridge, "one", robot, pc)
    mirroring(bridge, "two", pc, third)
    eventually(lambda: {LIDAR, CAMERA} <= {*names(pc)}, what="the nodes in the second domain")
    node = stands(pc, "later")
    eventually(lambda: "/later" in names(third), what="the third domain's bridge has looked since")
    eventually(lambda: "/later" in names(robot), what="so has the first one's")
    assert {LIDAR, CAMERA}.isdisjoint(names(third))
    assert names(robot).count(LIDAR) == 1
    node.destroy_node()
    eventually(lambda: "/later" not in (*names(third), *names(robot)), what="its end")


def test_two_bridges_mirror_a_node_once(bridge: Bridge, far: FarProgram, robot: Domain, pc: Domain) -> None:
    """They double messages as they do without it, and none goes round."""
    pairs = {name: mirroring(bridge, name, robot, pc) for name in ("one", "two")}
    heard = {domain: domain.listener("/scan") for domain in (robot, pc)}

    def counts() -> list[MirrorCount]:
        def count(server: Engine, name: str) -> MirrorCount:
            found = MIRRORED.of(link(server, name))
            assert found is not None
            return found

        return [count(pair.server, name) for name, pair in pairs.items()]

    def others() -> list[str]:
        """The nodes of the program that one of the bridges leaves to the other one: others may be in the domains."""
        texts = [text for each in counts() for text in each.left_out]
        return [
            node for text in texts for node in (LIDAR, CAMERA) if has_text(text, NotMirrored.OTHER_BRIDGE, node=node)
        ]

    eventually(lambda: sorted(others()) == [CAMERA, LIDAR], what="each node by one of them")
    eventually(lambda: [name for name in names(pc) if name in (LIDAR, CAMERA)] == [CAMERA, LIDAR], what="each once")
    assert names(robot).count(LIDAR) == 1

    def says(words: str) -> bool:
        far.scan(words)
        return all(words in each.texts(100) for each in heard.values())

    eventually(lambda: says("begins"), what="heard everywhere")
    for pair in pairs.values():
        eventually(lambda pair=pair: route(pair.client, "/scan").state is State.OK, what="it carries it")
    for each in range(10):
        far.scan(f"count {each}")
    eventually(lambda: says("ends"), what="heard everywhere")
    assert [heard[robot].texts(1000).count(f"count {each}") for each in range(10)] == [1] * 10
    eventually(lambda: [heard[pc].texts(1000).count(f"count {each}") for each in range(10)] == [2] * 10, what="twice")
