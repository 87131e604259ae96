"""One side's questions for pictures of the other side's topics, on virtual time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced
from tests.support.wording import pattern, says

from rsb_bridge.link.extension import Denied, LinkError
from rsb_bridge.link.roles import ClientRole
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_bridge.route.crossing import Crossing
from rsb_extras.pictures.link_views import VIEW, LinkViews, PeerView, ViewRefused
from rsb_extras.pictures.picture import Wish

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context


async def test_nobody_sends_pictures_unasked(make_context: Callable[..., Context]) -> None:
    (link,) = ClientRole(make_context(), {"robot1": ()}).links()
    refusal = link.extensions.find(LinkViews).denial(link.end.rights, sends=True)
    assert refusal is not None
    assert says(refusal.reason, ViewRefused.NO_SENDING, peer="the server", owner="robot1")


async def test_a_look_without_an_answer_is_asked_again(
    make_context: Callable[..., Context], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A peer that has too many questions already ignores further ones."""
    sent: list[Any] = []
    replaced.LINK_SEND.set(monkeypatch, lambda _, message: sent.append(message))
    context = make_context()
    (link,) = ClientRole(context, {"robot1": ()}).links()
    route: Any = SimpleNamespace(id=2, local_topic=VIEW.route_name("1"), outgoing=False, crossing=Crossing.YES)
    context.internal[VIEW.name].advertise(TopicSpec(route.local_topic, "", "", Qos()), link.name)
    view = PeerView(route)
    for _ in range(2):
        with pytest.raises(LinkError, match=pattern(Denied.NO_ANSWER)):
            await link.extensions.find(LinkViews).next_picture(view, ("/map",), Wish(), 1.0)
    assert [look.topics for look in sent] == [("/map",)] * 2
