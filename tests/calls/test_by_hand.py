"""Calls that operators make by hand, from either side, through the engine and through a control socket."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest
import yaml
from nav_msgs.srv import GetPlan
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool
from tests.calls.by_hand_helpers import ready
from tests.calls.ledgers import called, counts, nothing_left
from tests.support import replaced
from tests.support.bridge import happened, route
from tests.support.waiting import eventually
from tests.support.wording import pattern, says

from rsb_bridge.api import EngineError, InvalidRequestError
from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import hash_of_text, read_description
from rsb_bridge.config.fields_text import FieldProblem, whole_fields
from rsb_bridge.control.protocol import RequestProblem
from rsb_bridge.engine.inspector import CALLS_AT_ONCE, CalledProblem
from rsb_bridge.link.extension import Denied
from rsb_bridge.model.calls import FIELDS_LENGTH
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import OWN_CONSOLE
from rsb_bridge.model.session import Topic
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.asked_calls import LandedText

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from tests.support.bridge import Bridge
    from tests.support.control import Machine
    from tests.support.domain import Domain
    from tests.support.spun import Spun

    from rsb_bridge.api import EngineApi
    from rsb_bridge.engine import Engine
    from rsb_bridge.model.snapshot import Event


class Lamp:
    """A node that serves /set on the server's side."""

    def __init__(self, spun: Spun) -> None:
        self.was: list[bool] = []
        self.goes_on = threading.Event()
        self.goes_on.set()
        spun.node.create_service(SetBool, "/set", self._set, qos_profile=QoSProfile(depth=2 * CALLS_AT_ONCE))

    def _set(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.was.append(request.data)
        self.goes_on.wait(60)
        response.success, response.message = True, f"größer: {request.data}"
        return response


@pytest.fixture
def lamp(start: Callable[..., Spun], pc: Domain) -> Lamp:
    return Lamp(start(pc, "lamp"))


def by_hand(engine: EngineApi, name: str, request: str, lane: str = "") -> Future[str]:
    return engine.call(route(engine, name).key, request, lane)


def test_call_over_link_is_recorded_on_both_sides(bridge: Bridge, lamp: Lamp) -> None:
    engines = server, client = bridge.both(called("/set"))
    ready(client, "/set")
    assert route(client, "/set").lanes == ("",)
    for engine, other, name in ((client, server, "robot1"), (server, client, "server")):
        answer = by_hand(engine, "/set", "data:\n  true").result(60)
        assert yaml.safe_load(answer) == {"success": True, "message": "größer: True"}
        mine, theirs = (
            eventually(lambda side=side, peers=peers: last_call(side, peers))
            for side, peers in ((engine, False), (other, True))
        )
        assert (mine.topic, mine.who, mine.new) == ("/set", OWN_CONSOLE, "data: true")
        assert (theirs.topic, theirs.who, theirs.new) == ("/set", f"{name} says: {OWN_CONSOLE}", "data: true")
    assert yaml.safe_load(by_hand(client, "/set", "").result(60))["message"] == "größer: False"
    assert lamp.was == [True, True, False]
    for engine in engines:
        eventually(lambda engine=engine: counts(engine, "/set").answered == 2, what="the calls of the callers' side")
        assert counts(engine, "/set").asked == 2
    nothing_left(*engines)


def last_call(engine: Engine, from_peer: bool) -> Event | None:
    found = (each for each in reversed(engine.events()) if each.code == EventCode.OPERATOR_CALLED)
    return next((each for each in found if each.from_peer is from_peer), None)


def test_call_from_providing_side_needs_no_link(bridge: Bridge, lamp: Lamp) -> None:
    server, client = bridge.both(called("/set"))
    ready(client, "/set")
    assert yaml.safe_load(by_hand(server, "/set", "{data: true}").result(60))["success"]
    client.stop()
    eventually(lambda: route(server, "/set").reason)
    assert yaml.safe_load(by_hand(server, "/set", "{data: false}").result(60))["message"] == "größer: False"
    assert lamp.was == [True, False]
    assert counts(server, "/set").asked == 0


def test_both_sides_record_what_became_of_a_call(bridge: Bridge, lamp: Lamp) -> None:
    """Answered on either side, expired, and given up by its operator."""
    server, client = bridge.both(called("/set", timeout=4.0))
    ready(client, "/set")

    def ended(count: int) -> list[str]:
        """The newest outcome, as both sides tell it."""
        newest = []
        for engine in (client, server):
            found = [each for each in engine.events() if each.code == EventCode.OPERATOR_CALL_ENDED]
            if len(found) < count:
                return []
            assert len(found) == count
            assert found[-1].topic == "/set"
            assert OWN_CONSOLE in found[-1].who
            newest.append(found[-1].new)
        return newest

    by_hand(client, "/set", "data: true").result(60)
    assert all("answered" in each for each in eventually(lambda: ended(1)))
    lamp.goes_on.clear()
    with pytest.raises(EngineError) as expired:
        by_hand(client, "/set", "data: true").result(60)
    assert all(str(expired.value) in each for each in eventually(lambda: ended(2)))
    lamp.goes_on.set()
    by_hand(server, "/set", "data: true").result(60)
    assert all("answered" in each for each in eventually(lambda: ended(3)))
    lamp.goes_on.clear()
    waiting = by_hand(client, "/set", "data: true")
    eventually(lambda: counts(client, "/set").in_flight)
    waiting.cancel()
    assert len(set(eventually(lambda: ended(4)))) == 1
    eventually(lambda: counts(client, "/set").lost == 1)
    assert not counts(client, "/set").in_flight
    lamp.goes_on.set()
    client.pause(route(client, "/set").key, True).result(60)
    with pytest.raises(EngineError):
        by_hand(client, "/set", "data: true").result(60)
    for engine in (client, server):
        codes = [each.code for each in engine.events()]
        assert codes.count(EventCode.OPERATOR_CALLED) == codes.count(EventCode.OPERATOR_CALL_ENDED) == 4


def test_call_refused_late_is_recorded_as_refused(bridge: Bridge, lamp: Lamp) -> None:
    _, client = bridge.both(called("/set", max_rate=0.01))
    ready(client, "/set")
    by_hand(client, "/set", "data: true").result(60)
    with pytest.raises(EngineError) as refused:
        by_hand(client, "/set", "data: true").result(60)
    event = eventually(lambda: happened(client, EventCode.OPERATOR_CALL_ENDED, str(refused.value)))
    assert event.new == f"failed: {refused.value}"
    assert lamp.was == [True]


def test_attached_console_calls_by_name_watcher_is_refused(bridge: Bridge, lamp: Lamp, machine: Machine) -> None:
    _, client = bridge.both(called("/set"))
    machine.serve(client)
    remote, watcher = machine.attach(), machine.attach(read_only=True)
    ready(client, "/set")
    assert yaml.safe_load(by_hand(remote, "/set", "data: true").result(60))["success"]
    event = eventually(lambda: happened(client, EventCode.OPERATOR_CALLED))
    assert event.who != OWN_CONSOLE
    with pytest.raises(EngineError):
        by_hand(watcher, "/set", "data: true").result(60)
    with pytest.raises(EngineError, match=pattern(FieldProblem.TOO_LONG)):
        by_hand(remote, "/set", "# " + "x" * FIELDS_LENGTH).result(60)
    with pytest.raises(EngineError, match=pattern(RequestProblem.TOO_LONG)):
        by_hand(remote, "/set", "# " + "x" * 1_000_000).result(60)
    assert remote.unreachable == ""
    assert lamp.was == [True]


def test_impossible_call_is_explained_and_not_sent(bridge: Bridge, lamp: Lamp) -> None:
    """A program that repeats a request with a misspelt field would have the same answer."""
    engines = _, client = bridge.both(called("/set"))
    ready(client, "/set")
    for engine in engines:
        for request, lane, words in (
            ("data: maybe", "", "data: 'maybe' is not true or false"),
            ("dat: true", "", "did you mean data"),
            ("a: &x 1\nb: *x", "", "aliases"),
            ("[" * 1000, "", "nested too deeply"),
            ("", "set", "has no 'set' to call"),
        ):
            with pytest.raises(EngineError if lane else InvalidRequestError) as refused:
                by_hand(engine, "/set", request, lane).result(60)
            assert words in str(refused.value)
        assert happened(engine, EventCode.OPERATOR_CALLED) is None
    assert counts(client, "/set").asked == 0
    assert lamp.was == []


def test_topics_and_unserved_names_cannot_be_called(bridge: Bridge) -> None:
    server, client = bridge.both(Topic("/chat", "transmit"), called("/nobody"))
    with pytest.raises(EngineError, match=pattern(Denied.NOT_CALLED, topic="/chat")):
        by_hand(client, "/chat", "").result(60)
    for engine in (server, client):
        eventually(lambda engine=engine: route(engine, "/nobody").cause == Cause.NO_SERVER)
        with pytest.raises(EngineError, match="no server of /nobody"):
            by_hand(engine, "/nobody", "").result(60)
    with pytest.raises(EngineError, match=pattern(Denied.NO_ROUTE)):
        client.call("nonsense", "").result(60)


def test_call_of_uninstalled_type_is_refused_in_words(
    bridge: Bridge, lamp: Lamp, monkeypatch: pytest.MonkeyPatch
) -> None:
    server, client = bridge.both(called("/set"))
    ready(client, "/set")

    replaced.IS_INTERFACE_PACKAGE.set(monkeypatch, lambda package: package != "std_srvs")
    replaced.LOOKS_FOR_TYPES.set(monkeypatch, SimpleNamespace(monotonic=lambda: -1.0))
    replaced.FOUND_TYPES.set(monkeypatch, {})  # last: the engines' threads look types up, too
    for engine in (server, client):
        with pytest.raises(EngineError, match=r"std_srvs/srv/SetBool is not installed here.*ros-[a-z]+-std-srvs"):
            by_hand(engine, "/set", "data: true").result(60)
    assert lamp.was == []


@pytest.mark.filterwarnings("ignore:failed to send response")  # what rclpy says to a client that has gone
def test_unanswered_call_expires_on_either_side(bridge: Bridge, lamp: Lamp, monkeypatch: pytest.MonkeyPatch) -> None:
    server, client = bridge.both(called("/set", timeout=4.5))
    ready(client, "/set")
    lamp.goes_on.clear()
    # Both at once, and long ones: what the callers' side knows of the other may be a second old.
    waiting = [(engine, by_hand(engine, "/set", "data: true")) for engine in (client, server)]
    for engine, call in waiting:
        with pytest.raises(EngineError, match=r"no answer within 4\.5 s") as error:
            call.result(60)
        if engine is client:  # the callers' side
            assert says(str(error.value).partition("; ")[2], LandedText.GIVEN)
    lamp.goes_on.set()
    eventually(lambda: counts(client, "/set").expired == 1)
    eventually(lambda: len(lamp.was) == 2)
    ready(client, "/set")
    assert yaml.safe_load(by_hand(client, "/set", "data: false").result(60))["success"]

    replaced.CALL_REPORTED.set(monkeypatch, lambda *_: None)  # as if the link hung
    lamp.goes_on.clear()
    with pytest.raises(EngineError) as unreported:
        by_hand(client, "/set", "data: true").result(60)
    lamp.goes_on.set()
    assert says(str(unreported.value).partition("; ")[2], LandedText.UNREPORTED), "it is not said to have landed"


def test_running_call_ends_with_link_and_with_pause(bridge: Bridge, lamp: Lamp) -> None:
    server, client = bridge.both(called("/set"))
    ready(client, "/set")
    lamp.goes_on.clear()
    waiting = by_hand(client, "/set", "data: true")
    eventually(lambda: lamp.was)
    client.pause(route(client, "/set").key, True).result(60)
    with pytest.raises(EngineError):
        waiting.result(60)
    with pytest.raises(EngineError, match="paused"):
        by_hand(client, "/set", "data: true").result(60)
    lamp.goes_on.set()
    client.pause(route(client, "/set").key, False).result(60)
    ready(client, "/set")
    lamp.goes_on.clear()
    waiting = by_hand(client, "/set", "data: false")
    eventually(lambda: lamp.was == [True, False])
    server.stop()
    with pytest.raises(EngineError):
        waiting.result(60)
    lamp.goes_on.set()
    eventually(lambda: not counts(client, "/set").in_flight)


def test_operators_calls_have_limit(bridge: Bridge, lamp: Lamp) -> None:
    _, client = bridge.both(called("/set"))
    ready(client, "/set")
    lamp.goes_on.clear()
    key = route(client, "/set").key
    waiting = [client.call(key, "data: true") for _ in range(CALLS_AT_ONCE)]
    with pytest.raises(EngineError, match=pattern(Denied.TOO_MANY_CALLS, limit=CALLS_AT_ONCE)):
        client.call(key, "data: false").result(60)
    lamp.goes_on.set()
    assert all(yaml.safe_load(each.result(60))["success"] for each in waiting)
    assert lamp.was == [True] * CALLS_AT_ONCE


def test_a_large_answer_is_cut_and_says_so(bridge: Bridge, start: Callable[..., Spun], pc: Domain) -> None:
    def plan(request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
        response.plan.header.frame_id = "x" * 100_000
        response.plan.poses = [request.start] * 30_000
        return response

    start(pc, "planner").node.create_service(GetPlan, "/plan", plan)
    _, client = bridge.both(called("/plan"))
    ready(client, "/plan")
    text = by_hand(client, "/plan", "start: {header: {frame_id: map}, pose: {position: {x: .5}}}").result(60)
    assert "# plan.header.frame_id: the first 65,536 of 100,000 characters" in text
    assert "of 30,000 elements" in text
    assert len(text) < 500_000
    poses = yaml.safe_load(text)["plan"]["poses"]
    assert 100 < len(poses) <= 1000
    assert poses[0]["pose"]["position"]["x"] == 0.5


def test_program_gets_a_large_answer_whole(
    bridge: Bridge, start: Callable[..., Spun], pc: Domain, machine: Machine
) -> None:
    """Up to what a frame of the control socket takes; beyond, a sentence says so."""
    name = "x" * 100_000

    def plan(request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
        response.plan.header.frame_id = name if request.tolerance < 2 else name * 170
        response.plan.poses = [request.start] * 30_000
        return response

    start(pc, "planner").node.create_service(GetPlan, "/plan", plan)
    _, client = bridge.both(called("/plan"))
    machine.serve(client)
    remote = machine.attach()
    ready(client, "/plan")
    request = "start: {header: {frame_id: map}, pose: {position: {x: .5}}}\ntolerance: "
    key = route(remote, "/plan").key
    whole = remote.call_whole(key, f"{request}1").result(60)
    description = read_description(whole.description, hash_of_text(whole.description))
    data, missing = whole_fields(decode(description, whole.payload, items=1 << 20, steps=1 << 20))
    assert (missing, whole.goal, len(data["plan"]["poses"])) == ("", "", 30_000)
    assert data["plan"]["header"]["frame_id"] == name
    assert data["plan"]["poses"][-1]["pose"]["position"]["x"] == 0.5
    with pytest.raises(EngineError, match=pattern(CalledProblem.TOO_LONG, type="nav_msgs/srv/GetPlan_Response")):
        remote.call_whole(key, f"{request}3").result(60)
    assert remote.unreachable == ""
