"""What features make of a topic's messages on their way in, and what one that fails costs."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced
from tests.support.bridge import happened, is_accepted, route
from tests.support.domain import LATCHED, text
from tests.support.inside import inside
from tests.support.waiting import eventually

from rsb_bridge import installed_features
from rsb_bridge.feature_api import Extension, Feature, MessageTransform, State, TransformError, Verdict
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from tests.support.bridge import Bridge

CHAT = Topic("/chat", "transmit", type="std_msgs/msg/String")


class _Upper(MessageTransform):
    def __init__(self, make: Callable[[bytes], bytes]) -> None:
        self.change = make  # type: ignore[method-assign, assignment]


class _Shouts(Extension):
    """Changes messages on the server's side only."""

    def __init__(self, link: Any) -> None:
        self.transform = self._transform
        self.link = link
        self.answered = asyncio.Event()
        self.answered.set()
        self.asked = 0
        self.changes = True
        self.make: Callable[[], Any] = lambda: _Upper(lambda content: content[:8] + content[8:].upper())

    def _transform(self, route: Any) -> Any:
        if self.link.is_client or not self.changes:
            return None
        self.asked += 1
        return self._later

    async def _later(self) -> Any:
        await self.answered.wait()
        return self.make()

    def again(self, make: Callable[[], Any]) -> None:
        self.make = make
        for each in self.link.routes.values():
            each.half.choose_transforms()


class _Shout(Feature):
    name = "shout"

    def extensions(self, link: Any) -> Iterable[Any]:
        return (_Shouts(link),)


@pytest.fixture
def shouts(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Any, _Shouts]:
    """A server that has the feature, its client, and the server's extension."""
    feature = _Shout()
    replaced.FEATURES_ASKED.set(monkeypatch, lambda method: (feature,) if method == "extensions" else ())
    monkeypatch.setattr(installed_features, "_faults", {})
    server, client = bridge.both()
    (link,) = inside(server).role.links()
    return server, client, link.extensions.find(_Shouts)


def opened(bridge: Bridge, client: Any) -> tuple[Callable[[str], object], Any]:
    """Return what publishes on a latched topic, and who hears it."""
    publisher = bridge.robot.publisher("/chat", qos=LATCHED)
    client.add_topic(CHAT).result(60)
    eventually(lambda: is_accepted(client, "/chat"), what="open")
    return lambda words: publisher.publish(text(words)), bridge.pc.listener("/chat", qos=LATCHED)


def test_messages_are_changed_and_wait_for_the_answer(bridge: Bridge, shouts: tuple[Any, Any, _Shouts]) -> None:
    server, client, extension = shouts
    inside(server).context.call(extension.answered.clear)
    publish, heard = opened(bridge, client)
    publish("one")
    eventually(lambda: extension.asked, what="the question")
    eventually(lambda: route(client, "/chat").ledger.offered, what="offered")
    assert heard.payloads == []
    inside(server).context.call(extension.answered.set)
    eventually(lambda: heard.payloads and heard.texts(1) == ["ONE"], what="the message")
    inside(server).context.call(lambda: extension.again(lambda: None))
    eventually(lambda: heard.texts(1) == ["one"], what="what is latched again, as it was")
    assert happened(server, EventCode.ROUTE_CHANGED_OTHERWISE)


@pytest.mark.parametrize("result", ["ONE", "one"])
def test_messages_wait_for_the_last_answer(bridge: Bridge, shouts: tuple[Any, Any, _Shouts], result: str) -> None:
    """It is asked again, as after a reload, while an opening's messages wait for the first answer."""
    server, client, extension = shouts
    context = inside(server).context
    context.call(extension.answered.clear)
    publish, heard = opened(bridge, client)
    publish("one")
    eventually(lambda: extension.asked, what="the question")
    eventually(lambda: route(client, "/chat").ledger.offered, what="offered")
    extension.changes = result == "ONE"
    context.call(lambda: extension.again(extension.make))
    if extension.changes:
        eventually(lambda: extension.asked == 2, what="the second question")
        assert heard.payloads == []
    context.call(extension.answered.set)
    eventually(lambda: heard.payloads and heard.texts(1) == [result], what="the message")


def test_a_transform_may_keep_back_and_judge(bridge: Bridge, shouts: tuple[Any, Any, _Shouts]) -> None:
    server, client, extension = shouts

    def refuse(_: bytes) -> bytes:
        raise TransformError("too loud: speak lower")

    def make() -> MessageTransform:
        made = _Upper(refuse)
        made.verdict = Verdict(State.DOWN, "shout.loud", "too loud: speak lower")
        return made

    extension.make = make
    publish, heard = opened(bridge, client)
    publish("one")
    eventually(lambda: happened(server, EventCode.ROUTE_NOT_CHANGED, "too loud: speak lower"), what="in the log")
    eventually(lambda: route(server, "/chat").cause == "shout.loud", what="the verdict")
    eventually(lambda: route(client, "/chat").ledger.dropped.get("not changed"), what="in the ledger")
    assert heard.payloads == []


def _fail(_: bytes = b"") -> Any:
    raise KeyError("it fails")


@pytest.mark.parametrize("make", [_fail, lambda: _Upper(_fail)])
def test_what_a_failing_transform_was_to_change_is_kept_back(
    bridge: Bridge, shouts: tuple[Any, Any, _Shouts], make: Callable[[], Any]
) -> None:
    server, client, extension = shouts
    extension.make = make
    publish, heard = opened(bridge, client)
    publish("one")
    eventually(lambda: happened(server, EventCode.ENGINE_FEATURE_LEFT_OUT, "transform"), what="a line")
    eventually(lambda: happened(server, EventCode.ROUTE_NOT_CHANGED, "the feature shout"), what="in the log")
    assert heard.payloads == []
