"""Pictures of topics, drawn where they are published: over a link or on this side, within rights."""

from __future__ import annotations

import asyncio
import itertools
import os
import signal
import threading
import time
from collections import Counter
from concurrent.futures import wait
from functools import partial
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from std_msgs.msg import String
from tests.support import constants, replaced
from tests.support.bridge import carries, linked, now
from tests.support.domain import LATCHED
from tests.support.inside import inside
from tests.support.participants import agree
from tests.support.waiting import eventually
from tests.support.wording import has_text, pattern

from rsb_bridge.api import EngineError
from rsb_bridge.config.name_rules import NameMistake
from rsb_bridge.config.rights import DeniedText
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Grant, Topic
from rsb_extras.pictures.link_views import VIEW, VIEWS_OF_PEER, LinkViews, PeerView, ViewCode, ViewRefused
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.map_view import MapProblem
from rsb_extras.pictures.picture import Cells, Picture, Wish, decode_picture
from rsb_extras.pictures.renderer import Renderer, renderer_of
from rsb_extras.pictures.tests import picture_places
from rsb_extras.pictures.topic_view import TopicView, ViewProblem
from rsb_extras.pictures.viewing import LookProblem, Viewing

if TYPE_CHECKING:
    from collections.abc import Iterator
    from concurrent.futures import Future

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.link.link import Link
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_extras.pictures.picture import Viewed
    from rsb_extras.pictures.worker import Task

WISH = Wish(width=60, height=30, rate=10.0, how="tree")


def look_at(engine: Engine, viewer: str, topics: tuple[str, ...], wish: Wish, link: str = "") -> Future[Viewed | None]:
    return engine.do(LookAtTopics(viewer, topics, wish, link))


def looked(engine: Engine, topic: str, wish: Wish = WISH, *, viewer: str = "me", link: str = "") -> Viewed:
    """Return the next picture that has content."""

    def look() -> Viewed | None:
        viewed = look_at(engine, viewer, (topic,), wish, link).result(30)
        return viewed if viewed is not None and viewed.picture.content is not None else None

    return eventually(look)


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
        self.is_known = partial(agree, domain.id, topic)
        """Whether the engines of its domain know what its node does."""
        self.x = 0.0

    def __call__(self) -> None:
        self.x += 1.0
        self._publisher.publish(pose(self.x))


def looked_while(talker: Talker, engine: Engine, topic: str, wish: Wish = WISH, **about: str) -> Viewed:
    """Return a picture while a talker talks."""
    eventually(talker.is_known)  # otherwise the bridge reports that nobody publishes it
    future = look_at(engine, about.get("viewer", "me"), (topic,), wish, about.get("link", ""))
    deadline = time.monotonic() + 180

    while True:
        while not future.done():
            assert time.monotonic() < deadline
            talker()
            time.sleep(0.02)
        try:
            viewed = future.result()
        except EngineError:  # on a busy machine the link may be lost for a moment
            assert time.monotonic() < deadline
            viewed = None
        if viewed is not None and viewed.picture.content is not None:
            return viewed
        future = look_at(engine, about.get("viewer", "me"), (topic,), wish, about.get("link", ""))


def feeds(view: TopicView) -> dict[str, Any]:
    """Return the subscriptions of a view."""
    return view._feeds


def viewer(engine: Engine) -> Any:
    """Return what shows the topics of the console `me`."""
    (viewing,) = (part for part in inside(engine)._parts if isinstance(part, Viewing))
    return viewing._views["me"].open


def views_drawn_by(link: Link) -> dict[Any, Any]:
    return link.extensions.find(LinkViews)._drawing


def views(engine: Engine) -> list[str]:
    return [
        key
        for link in inside(engine).role.links()
        for key, route in tuple(link.routes.items())
        if not route.purpose.is_shown
    ]


@pytest.fixture
def asks_soon_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """An operator who looks before there is a picture asks again after 3 s, not 10 s."""
    picture_places.LOOK_WAITS_AT_MOST.set(monkeypatch, 3.0)


@pytest.fixture(scope="module")
def both(shared: Bridge) -> tuple[Engine, Engine]:
    """A server and a client without topics."""
    return shared.both()


@pytest.fixture
def pair(both: tuple[Engine, Engine], robot: Domain, pc: Domain) -> Iterator[tuple[Engine, Engine]]:
    """Those two, on which no view is left afterwards."""
    yield both
    for engine in both:
        engine.do(EndLook("me")).result(30)
    eventually(lambda: not any(map(views, both)))


@pytest.mark.parametrize("viewer_is_server", [True, False])
def test_unbridged_topic_is_drawn_by_its_side(
    pair: tuple[Engine, Engine], robot: Domain, pc: Domain, viewer_is_server: bool
) -> None:
    """The view is in no snapshot and in no session."""
    viewer, sender = pair if viewer_is_server else reversed(pair)
    topic = "/on_robot" if viewer_is_server else "/on_pc"
    viewed = looked_while(Talker(robot if viewer_is_server else pc, topic), viewer, topic)
    assert "x: " in rows(viewed)
    assert viewed.where == now(viewer).links[0].name
    assert viewed.picture.type_name == "geometry_msgs/msg/PoseStamped"
    assert viewed.age is not None
    assert 0 <= viewed.age < 30
    began = [each for each in sender.events() if each.code == ViewCode.BEGAN and each.topic == topic]
    assert began
    assert ("the server" if viewer_is_server else now(viewer).links[0].name) in began[-1].text
    assert views(viewer)
    assert now(viewer).routes == now(sender).routes == ()
    assert viewer.session.topics == ()


def test_a_topic_of_this_side_is_drawn_here(pair: tuple[Engine, Engine], pc: Domain) -> None:
    talker = Talker(pc, "/pose")
    server, _ = pair
    viewed = looked_while(talker, server, "/pose")
    assert viewed.where == ""
    assert views(server) == []


@pytest.mark.parametrize("viewer_is_server", [True, False])
def test_a_silent_topic_names_its_publishers(pair: tuple[Engine, Engine], pc: Domain, viewer_is_server: bool) -> None:
    server, client = pair
    silent = [pc.publisher("/camera", Image, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))]
    silent += [pc.publisher("/camera", Image)]
    eventually(partial(agree, pc.id, "/camera"))
    context = inside(server).context
    eventually(lambda: len(context.ros.publishers("/camera")) == len(silent))
    viewed = look_at(server if viewer_is_server else client, "me", ("/camera",), WISH).result(30)
    assert viewed is not None
    assert (viewed.picture.content, viewed.picture.problem) == (None, "")
    assert "2 publishers" in viewed.picture.waiting
    assert "best effort" in viewed.picture.waiting


def test_bridged_topic_is_drawn_where_its_messages_are(bridge: Bridge, robot: Domain, pc: Domain) -> None:
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


def test_a_restart_neither_counts_nor_reports_a_view(
    bridge: Bridge, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A viewer that waits meanwhile gets the first picture after it."""
    picture_places.LOOK_WAITS_AT_MOST.set(monkeypatch, 60.0)
    server, client = bridge.both(Topic("/chat", "transmit"))
    talker = Talker(pc, "/on_pc")
    looked_while(talker, client, "/on_pc", link="robot1")
    while True:
        waiting = look_at(client, "me", ("/on_pc",), WISH, "robot1")
        if not wait([waiting], 1.0).done:
            break
    steps: list[str] = []
    client.restart(steps.append).result(60)
    assert steps[-1].startswith("1 of 1 ")

    def drawn() -> bool:
        talker()
        return waiting.done()

    eventually(drawn)
    assert waiting.result() is not None
    for engine in (server, client):
        assert not [event for event in engine.events() if event.code == EventCode.ROUTE_FAULT]


def test_a_view_ends_with_its_viewer(pair: tuple[Engine, Engine], robot: Domain) -> None:
    talker = Talker(robot, "/left")
    server, client = pair
    looked_while(talker, server, "/left")
    eventually(lambda: views(client))
    eventually(lambda: not views(server) and not views(client))
    ended = ViewCode.ENDED, "/left"
    eventually(lambda: any((event.code, event.topic) == ended for event in client.events()))


@pytest.mark.parametrize("deny", [Grant("/pose", may="look"), Grant("/pose", may="read"), "/pose"])
def test_who_may_not_look_gets_no_picture(bridge: Bridge, robot: Domain, deny: Grant | str) -> None:
    Talker(robot, "/pose")()
    server, client = bridge.server(), bridge.client(deny=(deny,))
    eventually(lambda: linked(client) and linked(server))
    with pytest.raises(EngineError, match=pattern(DeniedText.DENIED)):
        eventually(lambda: look_at(server, "me", ("/pose",), WISH, "robot1").result(30))


def test_looking_is_less_than_reading(bridge: Bridge, robot: Domain) -> None:
    talker = Talker(robot, "/pose")
    server, client = bridge.server(), bridge.client(allow=(Grant("/pose", may="look"),))
    eventually(lambda: linked(client) and linked(server))
    looked_while(talker, server, "/pose", link="robot1")
    key = server.add_topic(Topic("/pose", "transmit"), "robot1").result(60)
    eventually(
        lambda: any(each.key == key and has_text(each.reason, DeniedText.NOT_ALLOWED) for each in now(server).routes)
    )


@pytest.mark.parametrize("may", [True, False])
def test_map_gets_frames_that_its_viewer_may_look_at(
    bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch, may: bool
) -> None:
    """An odometry stands for the transforms, whose package is not among the tests'."""
    picture_places.VIEW_FRAMES.set(monkeypatch, ("/frames",))
    far, frames = robot.publisher("/far", PoseStamped), robot.publisher("/frames", Odometry)
    allowed = ("/far", "/other", "/frames")[: 2 + may]
    server, client = bridge.server(), bridge.client(allow=tuple(Grant(topic, may="look") for topic in allowed))
    eventually(lambda: linked(client) and linked(server))
    eventually(lambda: all(agree(robot.id, topic) for topic in ("/far", "/frames")))
    at_base, transform = pose(1.0), Odometry(child_frame_id="base_link")
    at_base.header.frame_id, transform.header.frame_id = "base_link", "map"

    def looked_at() -> Viewed | None:
        future = look_at(server, "me", ("/far",), Wish(width=40, height=20, rate=10.0, frame="map"), "robot1")
        while not future.done():
            far.publish(at_base)
            frames.publish(transform)
            time.sleep(0.02)
        return future.result()

    def drawn() -> Viewed | None:
        viewed = looked_at()
        (view,) = views_drawn_by(inside(client).role.links()[0]).values()
        is_settled = "/frames" in feeds(view[0]) if may else viewed is not None and viewed.picture.messages > 20
        return viewed if viewed is not None and is_settled and bool(viewed.picture.content) == may else None

    viewed = eventually(drawn)
    if may:
        assert "◆" in rows(viewed)
        context = inside(client).context
        fewer = msgspec.structs.replace(context.session, allow=context.session.allow[:-1])
        context.call(lambda: setattr(context, "session", fewer))

    def is_lost() -> bool:
        later = looked_at()
        return later is not None and has_text(later.picture.problem, MapProblem.NO_TRANSFORM)

    eventually(is_lost)


def test_right_that_is_taken_away_ends_view(bridge: Bridge, robot: Domain) -> None:
    talker = Talker(robot, "/pose")
    server, client = bridge.server(), bridge.client()
    eventually(lambda: linked(client) and linked(server))
    looked_while(talker, server, "/pose")
    (link,), context = inside(client).role.links(), inside(client).context
    assert views_drawn_by(link)
    denied = msgspec.structs.replace(context.session, deny=(Grant("/pose", may="look"),))

    def deny() -> None:
        context.session = denied

    context.call(deny)
    eventually(lambda: not views_drawn_by(link))

    def refused() -> bool:
        try:
            look_at(server, "me", ("/pose",), WISH).result(30)
        except EngineError as error:
            return has_text(str(error), DeniedText.DENIED)
        return False

    eventually(refused)


def test_a_view_knows_who_publishes(
    pair: tuple[Engine, Engine], robot: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    talker, authors, draw = Talker(robot, "/pose"), set[str](), Renderer.draw

    async def watched(renderer: Renderer, task: Task) -> Picture:
        authors.update(each.author for each in task.samples)
        return await draw(renderer, task)

    picture_places.DRAW.set(monkeypatch, watched)
    server, client = pair
    who = robot.node.get_fully_qualified_name()
    # A new publisher is known before the name of its node.
    eventually(lambda: [each.node for each in inside(client).context.ros.publishers("/pose")] == [who])
    looked_while(talker, server, "/pose")
    assert authors == {who}


def test_a_killed_drawing_process_is_started_again(pair: tuple[Engine, Engine], robot: Domain) -> None:
    talker = Talker(robot, "/pose")
    server, client = pair
    looked_while(talker, server, "/pose")
    renderer = inside(client).context.shared(renderer_of)
    pid = eventually(lambda: renderer.pid)
    os.kill(pid, signal.SIGKILL)

    def drawn_by_another() -> bool:  # a picture of the killed process may still wait
        looked_while(talker, server, "/pose")
        return renderer.pid not in (None, pid)

    eventually(drawn_by_another)


def test_carrying_goes_on_beside_a_view(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    talker = Talker(robot, "/pose")
    listener, publisher = pc.listener("/text"), robot.publisher("/text")
    server, _ = bridge.both(Topic("/text", "transmit"))
    carries([publisher], server, ["/text"])
    looked_while(talker, server, "/pose")
    carries([publisher], server, ["/text"])
    assert listener.matched


NO_NAMES = ["pose", "/pose/", "//pose", "~/pose", "/bad name", "{node}/pose"]


def test_a_peer_names_topics_as_rights_do(bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch) -> None:
    Talker(robot, "/pose")()
    server, client = bridge.server(), bridge.client(deny=("/pose",))
    eventually(lambda: linked(client) and linked(server))
    picture_places.CHECK_NAMES.set(monkeypatch, lambda _: None)
    (link,) = inside(client).role.links()
    for name in NO_NAMES:
        with pytest.raises(EngineError, match=pattern(NameMistake.NOT_ABSOLUTE)):
            look_at(server, "me", (name,), WISH, "robot1").result(30)
        assert not views_drawn_by(link)


def test_operator_names_published_topics_in_full(pair: tuple[Engine, Engine]) -> None:
    server, _ = pair
    for name in NO_NAMES:
        with pytest.raises(EngineError, match=pattern(NameMistake.NOT_ABSOLUTE)):
            look_at(server, "me", (name,), WISH).result(30)
    with pytest.raises(EngineError, match=pattern(LookProblem.NOWHERE)):
        look_at(server, "me", ("/nothing",), WISH).result(30)


@pytest.mark.parametrize("link", ["robot1", ""], ids=["there", "here"])
def test_view_given_up_while_opening_opens_again(
    pair: tuple[Engine, Engine], robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch, link: str
) -> None:
    """Its console has lost the bridge for a moment."""
    talker, opens = Talker(robot if link else pc, "/pose"), threading.Event()
    server, _ = pair
    eventually(talker.is_known)

    async def hang(*_: object) -> None:
        opens.set()
        await asyncio.Event().wait()

    with (picture_places.OPEN_VIEW if link else picture_places.CHECK_VIEW).during(hang):
        given_up = look_at(server, "me", ("/pose",), WISH, link)
        assert opens.wait(60)
        given_up.cancel()
    assert looked_while(talker, server, "/pose", link=link)


def test_view_that_cannot_be_opened_leaves_no_route(
    pair: tuple[Engine, Engine], robot: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    talker = Talker(robot, "/pose")
    server, _ = pair
    with monkeypatch.context() as patch:
        constants.VIEW_OPENED_WITHIN.set(patch, -1.0)
        for _ in range(VIEWS_OF_PEER + 1):
            with pytest.raises(EngineError, match=pattern(ViewRefused.NOT_OPENED)):
                look_at(server, "me", ("/pose",), WISH, "robot1").result(30)
    assert views(server) == []
    looked_while(talker, server, "/pose")


def test_early_viewer_gets_picture_after_sender_subscribes(pair: tuple[Engine, Engine], robot: Domain) -> None:
    """It was refused: this route carries no pictures."""
    server, client = pair
    ends, looks = inside(client).context.internal[VIEW.name], itertools.count()

    class Late(dict[Any, Any]):
        def get(self, key: Any, default: Any = None) -> Any:
            return super().get(key, default) if next(looks) > 2 else default

    ends.sources = Late(ends.sources)
    assert looked_while(Talker(robot, "/pose"), server, "/pose").where
    assert next(looks) > 3


def test_ended_view_makes_room_for_next(pair: tuple[Engine, Engine], robot: Domain) -> None:
    talker = Talker(robot, "/pose")
    server, client = pair
    for number in range(VIEWS_OF_PEER + 2):
        looked_while(talker, server, "/pose", viewer=f"viewer{number}")
        server.do(EndLook(f"viewer{number}")).result(30)
        assert views(server) == []
    eventually(lambda: not views(client))
    said = [event for engine in pair for event in engine.events()]
    assert not [event for event in said if VIEW.route_name() in f"{event.text} {event.topic}"]


def test_view_ended_while_opening_leaves_nothing(pair: tuple[Engine, Engine], robot: Domain) -> None:
    publisher = robot.publisher("/pose", PoseStamped)
    server, client = pair
    asked = look_at(server, "me", ("/pose",), WISH, "robot1")
    server.do(EndLook("me")).result(30)
    eventually(lambda: asked.done() or publisher.publish(pose(1.0)))
    eventually(lambda: not views(server) and not views(client))


def test_viewer_that_asks_for_two_leaves_nothing(pair: tuple[Engine, Engine], robot: Domain) -> None:
    talkers = [Talker(robot, topic) for topic in ("/pose", "/other")]
    server, client = pair
    futures = [look_at(server, "me", (topic,), WISH, "robot1") for topic in ("/pose", "/other")]
    deadline = time.monotonic() + 180
    while not all(future.done() for future in futures):
        assert time.monotonic() < deadline
        for talker in talkers:
            talker()
        time.sleep(0.02)
    assert len(views(server)) == 1
    eventually(lambda: not views(server) and not views(client))


@pytest.mark.usefixtures("asks_soon_again")
def test_picture_is_of_topic_asked_for_last(pair: tuple[Engine, Engine], pc: Domain) -> None:
    talker, publisher = Talker(pc, "/pose"), pc.publisher("/text")
    server, _ = pair
    looked_while(talker, server, "/pose")
    for _ in range(20):  # another picture waits for the viewer
        talker()
        time.sleep(0.02)
    own = viewer(server)
    eventually(own._news.is_set)
    eventually(partial(agree, pc.id, "/text"))

    def text() -> Viewed | None:
        publisher.publish(String(data="x"))
        return look_at(server, "me", ("/text",), WISH).result(30)

    assert eventually(text).picture.type_name == "std_msgs/msg/String"


def test_a_view_goes_on_over_a_new_connection(pair: tuple[Engine, Engine], robot: Domain) -> None:
    talker = Talker(robot, "/pose")
    server, client = pair
    looked_while(talker, server, "/pose")
    (link,), context = inside(client).role.links(), inside(client).context
    before = {drawn[0] for drawn in views_drawn_by(link).values()}
    assert before
    context.call(link.fail)
    eventually(lambda: before.isdisjoint(drawn[0] for drawn in views_drawn_by(link).values()))
    eventually(lambda: linked(client) and linked(server))

    def looked_again() -> bool:
        try:
            looked_while(talker, server, "/pose")
        except EngineError:
            return False
        return True

    eventually(looked_again)
    assert len(views(server)) == len(views(client)) == len(views_drawn_by(link)) == 1
    assert all(not feeds(view) for view in before)


@pytest.mark.usefixtures("asks_soon_again")
def test_kept_messages_return_for_new_process_or_kind(pair: tuple[Engine, Engine], robot: Domain) -> None:
    robot.publisher("/latched", qos=LATCHED).publish(String(data="kept"))
    server, client = pair
    eventually(partial(agree, robot.id, "/latched"))
    assert "kept" in rows(looked(server, "/latched"))
    assert "kept" in rows(looked(server, "/latched", msgspec.structs.replace(WISH, how="")))
    renderer = inside(client).context.shared(renderer_of)
    assert renderer.pid is not None
    os.kill(renderer.pid, signal.SIGKILL)
    assert "kept" in rows(looked(server, "/latched", msgspec.structs.replace(WISH, how="")))


def test_messages_are_counted_from_beginning_of_view(pair: tuple[Engine, Engine], pc: Domain) -> None:
    talker = Talker(pc, "/pose")
    server, _ = pair
    looked_while(talker, server, "/pose")
    before = looked_while(talker, server, "/pose").picture.messages
    unreliable = pc.publisher("/pose", PoseStamped, qos=QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    view = viewer(server)._drawing
    first = feeds(view)["/pose"]

    def resubscribed() -> bool:
        looked_while(talker, server, "/pose")
        return feeds(view).get("/pose", first) is not first

    eventually(resubscribed)
    assert looked_while(talker, server, "/pose").picture.messages > before
    assert unreliable.topic_name == "/pose"


def test_view_that_ends_early_leaves_no_subscription(pair: tuple[Engine, Engine], pc: Domain) -> None:
    Talker(pc, "/pose")()
    server, _ = pair
    context = inside(server).context

    async def deliver(_: Picture) -> None: ...

    async def run() -> TopicView:
        view = TopicView(context, ("/pose",), WISH, deliver)
        await view.check()
        assert feeds(view)
        task = view.start(asyncio.get_running_loop().create_task)
        task.cancel()
        await asyncio.wait([task])
        await asyncio.sleep(0)
        return view

    eventually(partial(context.ros.publishers, "/pose"))
    view = asyncio.run_coroutine_threadsafe(run(), context.loop).result(30)
    assert not feeds(view)


def test_topics_that_change_while_view_looks_them_up(pair: tuple[Engine, Engine], pc: Domain) -> None:
    for topic in ("/pose", "/other"):
        Talker(pc, topic)()
    server, _ = pair
    context = inside(server).context
    pictures: list[Picture] = []

    async def deliver(picture: Picture) -> None:
        pictures.append(picture)

    async def run() -> bool:
        view = TopicView(context, ("/pose",), WISH, deliver)
        task = view.start(asyncio.get_running_loop().create_task)
        await asyncio.sleep(0)  # it looks for the publishers of the first topic
        view.change(("/other",), WISH)
        await asyncio.wait([task], timeout=1.0)
        ended = task.done()
        task.cancel()
        return ended

    for topic in ("/pose", "/other"):
        eventually(partial(context.ros.publishers, topic))
    assert not asyncio.run_coroutine_threadsafe(run(), context.loop).result(30)


@pytest.mark.usefixtures("asks_soon_again")
def test_a_message_that_is_too_large_is_reported(
    pair: tuple[Engine, Engine], pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture_places.VIEW_MESSAGE_LIMIT.set(monkeypatch, 100)
    publisher = pc.publisher("/text")
    server, _ = pair

    def problem() -> str:
        publisher.publish(String(data="x" * 200))
        try:
            viewed = look_at(server, "me", ("/text",), WISH).result(30)
        except EngineError:
            return ""
        return "" if viewed is None else viewed.picture.problem

    assert has_text(eventually(problem), ViewProblem.MESSAGE_TOO_LARGE)


def test_publishers_are_not_looked_up_for_each_picture(
    pair: tuple[Engine, Engine], pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    talker = Talker(pc, "/pose")
    server, _ = pair
    ros, asked = inside(server).context.ros, Counter[str]()
    find = replaced.ROS_PUBLISHERS.value

    def counted(node: object, topic: str) -> list[Endpoint]:
        asked[topic] += node is ros
        found: list[Endpoint] = find(node, topic)
        return found

    topics = ("/pose", "/absent")
    eventually(partial(ros.publishers, "/pose"))
    replaced.ROS_PUBLISHERS.set(monkeypatch, counted)
    began, pictures = time.monotonic(), 0
    future = look_at(server, "me", topics, WISH)
    while pictures < 20:
        talker()
        time.sleep(0.02)
        if future.done():
            pictures += future.result() is not None
            future = look_at(server, "me", topics, WISH)
    # To find its side, to subscribe, and then now and then. The bridge looks for other bridges' topic meanwhile, and
    # its book of nodes after the two changes of the graph.
    most = 4 + (time.monotonic() - began) / picture_places.VIEW_RESOLVE_EVERY.value
    assert max(asked[topic] for topic in topics) <= most


# -- contents that stay the same


class Still:
    """Publishes the same pose for as long as somebody waits for a picture."""

    def __init__(self, domain: Domain, topic: str, x: float = 7.0) -> None:
        self._topic, self.x = topic, x
        self._publisher = domain.publisher(topic, PoseStamped)
        eventually(partial(agree, domain.id, topic))

    def looked_at(self, engine: Engine) -> Viewed | None:
        """Return the next picture of any kind."""
        future = look_at(engine, "me", (self._topic,), WISH, "robot1")
        deadline = time.monotonic() + 60
        while not future.done():
            assert time.monotonic() < deadline
            self._publisher.publish(pose(self.x))
            time.sleep(0.02)
        return future.result()

    def drawn(self, engine: Engine) -> Viewed | None:
        """Return the next picture if it has a content."""
        viewed = self.looked_at(engine)
        return viewed if viewed is not None and viewed.picture.content is not None else None


@pytest.fixture
def dropped(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """Pictures that views drop: the first one with a content, each time that the list is empty."""
    lost: list[bytes] = []
    receive = PeerView.receive

    def receive_but_one(view: PeerView, encoded: bytes) -> None:
        if not lost and decode_picture(encoded).content is not None:
            lost.append(encoded)
        else:
            receive(view, encoded)

    monkeypatch.setattr(PeerView, "receive", receive_but_one)
    return lost


def test_content_that_stays_crosses_once(pair: tuple[Engine, Engine], robot: Domain) -> None:
    """Further pictures show it, too, with another number of messages, and take few bytes."""
    (server, _), still = pair, Still(robot, "/still")
    first = eventually(lambda: still.drawn(server))

    def unchanged() -> Viewed | None:
        return viewed if (viewed := still.drawn(server)) is not None and viewed.picture.is_unchanged else None

    second = eventually(unchanged)
    assert rows(second) == rows(first)
    assert second.encoded < first.encoded / 2
    assert second.picture.messages > first.picture.messages
    still.x = 8.0
    eventually(lambda: "x: 8" in rows(viewed) if (viewed := still.drawn(server)) is not None else None)


def test_content_that_link_dropped_is_asked_for(
    pair: tuple[Engine, Engine], robot: Domain, dropped: list[bytes]
) -> None:
    """Otherwise the viewer would see none for as long as nothing moves."""
    (server, _), still = pair, Still(robot, "/dropped")
    viewed = eventually(lambda: still.drawn(server))
    assert dropped
    assert "x: 7" in rows(viewed)
    assert not viewed.picture.is_unchanged


def test_content_of_former_opening_is_not_shown(bridge: Bridge, robot: Domain, dropped: list[bytes]) -> None:
    """Each opening numbers contents from 1."""
    server, client = bridge.server(), bridge.client()
    eventually(lambda: linked(client) and linked(server))
    dropped.append(b"")
    still = Still(robot, "/still")
    eventually(lambda: still.drawn(server))
    client.restart(lambda _: None).result(60)
    eventually(lambda: linked(client) and linked(server))
    still.x = 9.0
    dropped.clear()

    def shows_new() -> bool:
        try:
            viewed = still.drawn(server)
        except EngineError:  # the link comes back
            return False
        return viewed is not None and "x: 9" in rows(viewed)

    eventually(shows_new)
    assert dropped
