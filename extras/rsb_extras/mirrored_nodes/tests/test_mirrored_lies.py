"""A peer that lies about its nodes: what it can make stand here is bounded."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import msgspec
import zstandard
from tests.link.foreign_proposals_helpers import rogue
from tests.support.bridge import happened
from tests.support.waiting import eventually

from rsb_bridge.model.snapshot import State
from rsb_extras.mirrored_nodes import GraphKeys
from rsb_extras.mirrored_nodes.link_mirrors import MOST, MirrorCode
from rsb_extras.mirrored_nodes.mirror_table import NotMirrored, is_mirrorable
from rsb_extras.nodes.node_data import AskNodes, NodeChanges, NodesNews, NodeState

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

BAD = "/_rsb_robot1_0123abcd", "/_hidden", "/a/_b", "a", "/", "/a-b", "/a//b", "/1st", "/a b", "/stock"


def test_nodes_of_a_liar_are_bounded(bridge: Bridge, pc: Domain) -> None:
    """Of a thousand names, 200 stand here; no bridge's, no hidden one, none that ROS refuses or that exists."""
    server = bridge.server(features={"graph": GraphKeys(nodes=True)})
    names = [*BAD, *(f"/made_up_{number}" for number in range(1000 - len(BAD)))]
    with rogue(bridge, "nodes") as client:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        changes = NodeChanges(1, 1, True, 0, nodes=tuple(NodeState(name) for name in names))
        request = client.wait_for(AskNodes).request
        client.say(NodesNews(request, zstandard.compress(msgspec.msgpack.encode(changes))))

        def made_up() -> int:
            client.say(NodesNews(0, b""))  # a sign of life, which answers nothing
            return sum(name.startswith("made_up_") for name, _ in pc.node.get_node_names_and_namespaces())

        too_many = partial(happened, server, MirrorCode.LEFT_OUT, NotMirrored.TOO_MANY, limit=MOST)
        eventually(lambda: made_up() == MOST and too_many(), what="as many as may stand here")
        found = pc.node.get_node_names_and_namespaces()
        assert [name for name, _ in found].count("stock") == 1
        others = {f"{namespace.rstrip('/')}/{name}" for name, namespace in found} - {"/stock"}
        assert not others.intersection(BAD)
    eventually(
        lambda: not any(name.startswith("made_up_") for name, _ in pc.node.get_node_names_and_namespaces()),
        what="their end with the link",
    )


def test_names_that_may_be_mirrored() -> None:
    assert not any(map(is_mirrorable, (*BAD[:-1], "", "/" + 255 * "x")))
    assert is_mirrorable("/stock")
    assert is_mirrorable("/ns/lidar_2")
