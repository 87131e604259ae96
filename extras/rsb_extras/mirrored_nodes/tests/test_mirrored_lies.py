"""A peer that lies about its nodes: what it can make stand here is bounded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import zstandard
from tests.link.foreign_proposals_helpers import rogue
from tests.support.waiting import eventually
from tests.support.wording import has_text

from rsb_bridge.model.snapshot import State
from rsb_extras.mirrored_nodes import GraphKeys
from rsb_extras.mirrored_nodes.link_mirrors import MOST, MirrorCode
from rsb_extras.mirrored_nodes.mirror_table import NotMirrored, is_mirrorable
from rsb_extras.nodes.node_data import AskNodes, NodeChanges, NodesNews, NodeState

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.model.snapshot import Event

BAD = "/_rsb_robot1_0123abcd", "/_hidden", "/a/_b", "a", "/", "/a-b", "/a//b", "/1st", "/a b", "/stock"


def test_nodes_of_a_liar_are_bounded(bridge: Bridge, pc: Domain) -> None:
    """Of a thousand names, 200 stand here; no bridge's, no hidden one, none that ROS refuses or that exists."""
    server = bridge.server(features={"graph": GraphKeys(nodes=True)})
    names = [*BAD, *(f"/made_up_{number}" for number in range(1000 - len(BAD)))]
    with rogue(bridge, "nodes") as client:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")

        def tell(number: int) -> None:
            changes = NodeChanges(1, number, True, 0, nodes=tuple(map(NodeState, names)))
            request = client.wait_for(AskNodes).request
            client.say(NodesNews(request, zstandard.compress(msgspec.msgpack.encode(changes))))

        def made_up() -> set[str]:
            client.say(NodesNews(0, b""))  # a sign of life, which answers nothing
            found = {f"/{name}" for name, _ in pc.node.get_node_names_and_namespaces()}
            return {name for name in found if name.startswith("/made_up_")}

        def too_many() -> list[Event]:
            found = (each for each in server.events() if each.code == MirrorCode.LEFT_OUT)
            return [each for each in found if has_text(each.text, NotMirrored.TOO_MANY, limit=MOST)]

        tell(1)
        eventually(lambda: len(made_up()) == MOST and too_many(), what="as many as may stand here")
        gone = min(made_up())
        names.remove(gone)
        tell(2)
        eventually(lambda: gone not in made_up() and len(made_up()) == MOST, what="another one in its place")
        assert len(too_many()) == 1, "another number of them is no news"
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
