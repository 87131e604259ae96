"""A feature's verdict on a route: what both sides show and log of it, and what one that fails costs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced
from tests.support.bridge import happened, is_accepted, now, route
from tests.support.inside import inside
from tests.support.waiting import eventually

from rsb_bridge import installed_features
from rsb_bridge.feature import Feature
from rsb_bridge.link.extension import Extension
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Verdict

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from tests.support.bridge import Bridge

SCAN = Topic("/scan", "transmit", type="std_msgs/msg/String")
BENT = Verdict(State.SLOW, "watch.bent", "the mast is bent: straighten it")
BENT_HERE = Verdict(State.SLOW, "watch.bent", BENT.text, here=True)


class _Opinion(Extension):
    def __init__(self, link: Any) -> None:
        self._link, self.asked = link, 0
        self.explanation = self._explain
        self.answer: Callable[[], Any] = type(None)
        self.knows: Callable[[Verdict], Any] = lambda _: None

    def _explain(self, route: Any, verdict: Verdict) -> Verdict | None:
        return self.knows(verdict) if self._link.is_client else None

    def verdict(self, route: Any) -> Verdict | None:
        self.asked += 1
        return self.answer() if self._link.is_client else None

    def say(self, answer: Callable[[], Any]) -> None:
        """Answer otherwise from now on."""
        self.answer = answer
        for each in self._link.routes.values():
            each.judge_again()


class _Watch(Feature):
    name = "watch"

    def extensions(self, link: Any) -> Iterable[Any]:
        return (_Opinion(link),)


@pytest.fixture
def watched(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Any, _Opinion]:
    """A server and a client that have the feature, and the client's opinion."""
    feature = _Watch()
    replaced.FEATURES_ASKED.set(monkeypatch, lambda method: (feature,) if method == "extensions" else ())
    monkeypatch.setattr(installed_features, "_faults", {})
    server, client = bridge.both(SCAN)
    eventually(lambda: is_accepted(client, "/scan"), what="open")
    (link,) = inside(client).role.links()
    return server, client, link.extensions.find(_Opinion)


def cause(engine: Any) -> str:
    return route(engine, "/scan").cause


def say(client: Any, opinion: _Opinion, answer: Callable[[], Any]) -> None:
    inside(client).context.call(lambda: opinion.say(answer))


def test_both_sides_show_and_log_it(watched: tuple[Any, Any, _Opinion]) -> None:
    server, client, opinion = watched
    say(client, opinion, lambda: BENT)
    for engine, text in ((client, BENT.text), (server, f"robot1: {BENT.text}")):
        eventually(lambda engine=engine: cause(engine) == "watch.bent", what="the cause")
        shown = route(engine, "/scan")
        assert (shown.state, shown.reason) == (State.SLOW, text)
        event = eventually(lambda engine=engine: happened(engine, EventCode.ROUTE_FAULT), what="in the log")
        assert event.cause == "watch.bent"
    say(client, opinion, type(None))
    for engine in (client, server):
        eventually(lambda engine=engine: cause(engine) != "watch.bent", what="over")


def test_verdict_of_this_side_only_stays_here(watched: tuple[Any, Any, _Opinion]) -> None:
    server, client, opinion = watched
    say(client, opinion, lambda: BENT_HERE)
    eventually(lambda: happened(client, EventCode.ROUTE_FAULT), what="in the log here")
    assert cause(client) == "watch.bent"
    assert cause(server) != "watch.bent"
    assert happened(server, EventCode.ROUTE_FAULT) is None


def _fail() -> Any:
    raise RuntimeError("it fails")


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (_fail, "RuntimeError: it fails"),
        (lambda: "bent", "verdict returns a Verdict"),
        (lambda: Verdict(State.DOWN, "link_down", "not so"), "has to begin with watch."),
        (lambda: Verdict(State.DOWN, f"watch.{'a' * 250}", "too long"), "at most 255 printable characters"),
        (lambda: Verdict(State.DOWN, "watch.a\tb", "not printable"), "at most 255 printable characters"),
    ],
)  # fmt: skip
def test_failing_judge_is_left_out_with_a_line(
    watched: tuple[Any, Any, _Opinion], answer: Callable[[], Any], why: str
) -> None:
    _, client, opinion = watched
    say(client, opinion, answer)
    eventually(lambda: happened(client, EventCode.ENGINE_FEATURE_LEFT_OUT, why), what="a line")
    asked = opinion.asked
    say(client, opinion, lambda: BENT)
    snapshot = now(client)
    eventually(lambda: now(client).time > snapshot.time + 2, what="further ticks")
    assert opinion.asked == asked
    assert cause(client) != "watch.bent"


def _know(client: Any, opinion: _Opinion, knows: Callable[[Verdict], Any]) -> None:
    opinion.knows = knows
    say(client, opinion, type(None))


def test_explanation_adds_to_the_cores_text_on_both_sides(watched: tuple[Any, Any, _Opinion]) -> None:
    server, client, opinion = watched
    eventually(lambda: cause(client) == "no_publisher", what="its cause")
    state = route(client, "/scan").state
    _know(
        client,
        opinion,
        lambda verdict: Verdict(State.OK, "watch.mine", f"{verdict.text}: the mast fell", verdict.since),
    )
    for engine in (client, server):
        eventually(lambda engine=engine: route(engine, "/scan").reason.endswith(": the mast fell"), what="the text")
        assert (route(engine, "/scan").state, cause(engine)) == (state, "no_publisher")


def test_failing_explanation_is_left_out_with_a_line(watched: tuple[Any, Any, _Opinion]) -> None:
    _, client, opinion = watched
    _know(client, opinion, lambda _: _fail())
    eventually(lambda: happened(client, EventCode.ENGINE_FEATURE_LEFT_OUT, "RuntimeError: it fails"), what="a line")
    assert cause(client) == "no_publisher"
