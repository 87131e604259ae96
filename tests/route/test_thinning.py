"""What a topic leaves to others of its link."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from rsb_bridge.route.thinning import Share, Thinning

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import RawMessage

if TYPE_CHECKING:
    from rsb_bridge.channel.channel import SendingChannel


class TakesAll:
    """A channel."""

    ready, carrier, congested = True, None, False

    def send(self, _: object) -> None: ...


def test_a_topic_that_is_held_back_goes_on_as_soon_as_its_share_is_larger() -> None:
    thinning = Thinning(0.0)
    thinning.take_share(Share(1.0, 10.0, 20.0, "/first"), low=False, qos=Qos(), now=0.0)
    thinning.over(cast("SendingChannel", TakesAll()), 0.0).send([(bytes(1940), 0, 0)])
    assert thinning.wait(0.0) == 2000.0
    thinning.take_share(Share(1000.0, 1e4, 2e4, "/first"), low=False, qos=Qos(), now=0.0)
    assert thinning.wait(0.0) == 2.0
    thinning.take_share(None, low=False, qos=Qos(), now=1.0)
    assert thinning.wait(1.0) == 0.0


def test_a_topic_that_recovers_is_not_said_to_be_thinned_to_what_it_wants() -> None:
    """It publishes at 20 Hz throughout; at 20 s its share becomes larger than that."""
    thinning, qos = Thinning(0.0), Qos(reliability="best_effort")
    said: dict[int, tuple[float, float] | None] = {}
    for second in range(40):
        share = Share(15_000.0 if second < 20 else 50_000.0, 1e4, 4e4, "/first")
        thinning.take_share(share, low=False, qos=qos, now=second)
        stamps = [int((second + each / 20) * 1e9) for each in range(20)]
        kept = thinning.keep([RawMessage(b"", stamp, b"gid", 1) for stamp in stamps], second + 0.9)
        thinning.offered += len(kept)
        thinning.packed(len(kept), len(kept) * 940)
        thinning.look(second + 1.0)
        shown = thinning.shown()
        said[second] = None if shown is None else (shown.rate, shown.wanted)
    assert all(said[second] for second in range(5, 20))
    assert said[39] is None
    for figures in filter(None, said.values()):
        rate, wanted = (round(each) for each in figures)
        assert rate < wanted
