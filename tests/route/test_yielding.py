"""What a topic leaves to others of its link."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from rsb_bridge.model.qos import Qos
from rsb_bridge.route.yielding import Share, Yielding

if TYPE_CHECKING:
    from rsb_bridge.channel.channel import SendingChannel


class TakesAll:
    """A channel."""

    ready, carrier, congested = True, None, False

    def send(self, _: object) -> None: ...


def test_a_topic_that_is_held_back_goes_on_as_soon_as_its_share_is_larger() -> None:
    yielding = Yielding(0.0)
    yielding.told(Share(1.0, 10.0, 20.0, "/first"), low=False, qos=Qos(), now=0.0)
    yielding.over(cast("SendingChannel", TakesAll()), 0.0).send([(bytes(1940), 0, 0)])
    assert yielding.wait(0.0) == 2000.0
    yielding.told(Share(1000.0, 1e4, 2e4, "/first"), low=False, qos=Qos(), now=0.0)
    assert yielding.wait(0.0) == 2.0
    yielding.told(None, low=False, qos=Qos(), now=1.0)
    assert yielding.wait(1.0) == 0.0
