"""While nobody looks, a link is shown again if more than its figures has changed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rsb_bridge.engine.bridge import Bridge
from rsb_bridge.model.session import Client
from rsb_bridge.model.snapshot import Snapshot, State
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.telemetry.snapshot_publisher import SnapshotPublisher

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.link.link import Link


@pytest.fixture
def link(make_context: Callable[..., Context]) -> Link:
    context = make_context(name="control", role="server", clients=(Client("robot"),), use_encryption=False)
    shown = SnapshotPublisher(Snapshot(0.0, "control", "server", "", 0, running=False), context.events, context.clock)
    (made,) = Bridge(context, {"robot": ()}, shown).role.links()
    return made


def test_link_is_not_shown_again_for_its_figures(link: Link) -> None:
    assert not link.only_counts
    link.snapshot()
    link.traffic.rx_bytes += 1000
    assert link.only_counts


@pytest.mark.parametrize(
    "happens",
    [
        lambda link: link.status.up(1.0),
        lambda link: link.status.down(LinkCause.LOST, "the cable is out"),
        lambda link: setattr(link.unsaved, "there", True),
        lambda link: setattr(link, "connections", 2),
    ],
    ids=["up", "down", "unsaved", "connection"],
)
def test_link_is_shown_again_if_something_happens(happens: Callable[[Link], None], link: Link) -> None:
    link.snapshot()
    happens(link)
    assert not link.only_counts
    link.snapshot()
    assert link.only_counts


def test_warning_of_link_is_shown_at_once(link: Link) -> None:
    link.status.up(1.0)
    assert link.snapshot().state is State.OK
    link.fault.duplicates.tried("192.0.2.1", "spare", link.context.now(), link.context.wall())
    assert not link.only_counts
    assert link.snapshot().warning
