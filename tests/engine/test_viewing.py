"""Pictures of topics, drawn where they are published: over a link or on this side, within rights."""

from __future__ import annotations

import os
import signal
import time
from typing import TYPE_CHECKING

import msgspec
import pytest
from geometry_msgs.msg import PoseStamped
from tests.support.bridge import carries, linked, now
from tests.support.waiting import eventually
from tests.support.wording import has_text, pattern

from rsb_bridge.api import EngineError
from rsb_bridge.config.rights import DeniedText
from rsb_bridge.engine.viewing import LookProblem
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.pictures import Cells, Wish
from rsb_bridge.model.session import Grant, Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.pictures import Viewed

WISH = Wish(width=60, height=30, rate=10.0, how="tree")


def looked(engine: Engine, topic: str, wish: Wish = WISH, *, viewer: str = "me", link: str = "") -> Viewed:
    """Return the next picture that has content."""

    def look() -> Viewed | None:
        viewed = engine.look(viewer, (topic,), wish, link).result(30)
        return viewed if viewed is not None and viewed.picture.content is not None else None

    return eventually(look, 30)


def rows(viewed: Viewed) -> str:
    content = viewed.picture.content
    assert isinstance(content, Cells)
    return "\n".join(content.rows)


def pose(x: float) -> PoseStamped:
    message = PoseStamped()
    message.pose.position.x = x
    return message


class Talker:
    """Publishes poses until it is closed, each further along x."""

    def __init__(self, domain: Domain, topic: str) -> None:
        self._publisher = domain.publisher(topic, PoseStamped)
        self.x = 0.0

    def __call__(self) -> None:
        self.x += 1.0
        self._publisher.publish(pose(self.x))


def looked_while(talker: Talker, engine: Engine, topic: str, wish: Wish = WISH, **about: str) -> Viewed:
    """Return a picture while a talker talks."""
    future = engine.look(about.get("viewer", "me"), (topic,), wish, about.get("link", ""))
    deadline = time.monotonic() + 30

    while True:
        while not future.done():
            assert time.monotonic() < deadline
            talker()
            time.sleep(0.02)
        viewed = future.result()
        if viewed is not None and viewed.picture.content is not None:
            return viewed
        future = engine.look(about.get("viewer", "me"), (topic,), wish, about.get("link", ""))


def views(engine: Engine) -> list[str]:
    assert engine._bridge is not None
    return [key for link in engine._bridge.links() for key, route in link.routes.items() if not route.shown]


@pytest.mark.parametrize("viewer_is_server", [True, False])
def test_a_topic_that_is_not_bridged_is_drawn_by_its_side(
    bridge: Bridge, robot: Domain, pc: Domain, viewer_is_server: bool
) -> None:
    talker = Talker(robot if viewer_is_server else pc, "/pose")
    server, client = bridge.both()
    viewer, sender = (server, client) if viewer_is_server else (client, server)
    viewed = looked_while(talker, viewer, "/pose")
    assert "x: " in rows(viewed)
    assert viewed.where == now(viewer).links[0].name
    assert viewed.picture.type_name == "geometry_msgs/msg/PoseStamped"
    assert viewed.age is not None
    assert 0 <= viewed.age < 30
    assert any(event.code == EventCode.LINK_VIEW_BEGAN and event.topic == "/pose" for event in sender.events())
    assert viewer.session.topics == ()


def test_views_are_in_no_snapshot_and_in_no_session(bridge: Bridge, robot: Domain) -> None:
    talker = Talker(robot, "/pose")
    server, client = bridge.both()
    looked_while(talker, server, "/pose")
    assert views(server)
    assert now(server).routes == now(client).routes == ()


def test_a_topic_of_this_side_is_drawn_here(bridge: Bridge, pc: Domain) -> None:
    talker = Talker(pc, "/pose")
    server, _ = bridge.both()
    viewed = looked_while(talker, server, "/pose")
    assert viewed.where == ""
    assert views(server) == []


def test_a_bridged_topic_is_drawn_where_its_messages_are(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    talker = Talker(robot, "/pose")
    listener = pc.listener("/pose", PoseStamped)
    server, client = bridge.both(Topic("/pose", "transmit"))

    def heard() -> list[int]:
        talker()
        return listener.received

    eventually(heard)
    viewed = looked_while(talker, server, "/pose")
    assert viewed.where == ""
    assert views(client) == []


def test_a_view_ends_with_its_viewer(bridge: Bridge, robot: Domain) -> None:
    talker = Talker(robot, "/pose")
    server, client = bridge.both()
    looked_while(talker, server, "/pose")
    eventually(lambda: views(client))
    eventually(lambda: not views(server) and not views(client), 30)
    eventually(lambda: any(event.code == EventCode.LINK_VIEW_ENDED for event in client.events()))


@pytest.mark.parametrize("deny", [Grant("/pose", may="look"), Grant("/pose", may="read"), "/pose"])
def test_who_may_not_look_gets_no_picture(bridge: Bridge, robot: Domain, deny: Grant | str) -> None:
    Talker(robot, "/pose")()
    server, client = bridge.server(), bridge.client(deny=(deny,))
    eventually(lambda: linked(client) and linked(server))
    with pytest.raises(EngineError, match=pattern(DeniedText.DENIED)):
        eventually(lambda: server.look("me", ("/pose",), WISH, "robot1").result(30), 30)


def test_looking_is_less_than_reading(bridge: Bridge, robot: Domain) -> None:
    talker = Talker(robot, "/pose")
    server, client = bridge.server(), bridge.client(allow=(Grant("/pose", may="look"),))
    eventually(lambda: linked(client) and linked(server))
    looked_while(talker, server, "/pose", link="robot1")
    key = server.add_topic(Topic("/pose", "transmit"), "robot1").result(10)
    refused = eventually(lambda: next((r.reason for r in now(server).routes if r.key == key and r.reason), None), 30)
    assert has_text(refused, DeniedText.NOT_ALLOWED)


def test_a_right_that_is_taken_away_ends_the_view(bridge: Bridge, robot: Domain) -> None:
    talker = Talker(robot, "/pose")
    server, client = bridge.server(), bridge.client()
    eventually(lambda: linked(client) and linked(server))
    looked_while(talker, server, "/pose")
    assert client._bridge is not None
    (link,), context = client._bridge.links(), client._bridge.context
    assert link.views._drawing
    denied = msgspec.structs.replace(context.session, deny=(Grant("/pose", may="look"),))
    context.call(lambda: setattr(context, "session", denied))
    eventually(lambda: not link.views._drawing, 30)

    def refused() -> bool:
        try:
            server.look("me", ("/pose",), WISH).result(30)
        except EngineError as error:
            return has_text(str(error), DeniedText.DENIED)
        return False

    eventually(refused, 30)


def test_nobody_publishes_it(bridge: Bridge) -> None:
    server, _ = bridge.both()
    with pytest.raises(EngineError, match=pattern(LookProblem.NOWHERE)):
        server.look("me", ("/nothing",), WISH).result(30)


def test_a_killed_drawing_process_is_started_again(bridge: Bridge, robot: Domain) -> None:
    talker = Talker(robot, "/pose")
    server, client = bridge.both()
    looked_while(talker, server, "/pose")
    assert client._bridge is not None
    renderer = client._bridge.context.renderer
    pid = eventually(lambda: renderer.pid)
    os.kill(pid, signal.SIGKILL)
    looked_while(talker, server, "/pose")
    assert renderer.pid not in (None, pid)


def test_carrying_goes_on_beside_a_view(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    talker = Talker(robot, "/pose")
    listener, publisher = pc.listener("/text"), robot.publisher("/text")
    server, _ = bridge.both(Topic("/text", "transmit"))
    carries([publisher], server, ["/text"])
    looked_while(talker, server, "/pose")
    carries([publisher], server, ["/text"])
    assert listener.matched
