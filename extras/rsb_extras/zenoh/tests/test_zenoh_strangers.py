"""Memory of strangers in a Zenoh network, who have not proven a key."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.link.strangers_helpers import SAID, strangers_of
from tests.support.waiting import eventually

from rsb_bridge.wire.framing import STRANGER_LIMIT
from rsb_extras.zenoh import ZenohSettings

if TYPE_CHECKING:
    import weakref

    from tests.support.bridge import Bridge


@pytest.mark.usefixtures("no_collector")
def test_refused_stream_over_zenoh_is_freed_at_once(bridge: Bridge, arrived: list[weakref.ref[object]]) -> None:
    zenoh = pytest.importorskip("zenoh")
    from rsb_extras.zenoh.endpoint import ROOT
    from rsb_extras.zenoh.sample_header import Header, SampleKind
    from rsb_extras.zenoh.tests.zenoh_router import Router, stranger

    router = Router()
    try:
        server = bridge.server(server_ip="zenoh", features={"zenoh": ZenohSettings(connect=(router.endpoint,))})
        with stranger(router) as other:
            at = eventually(lambda: [str(each.ok.key_expr) for each in other.liveliness().get(f"{ROOT}/**") if each.ok])
            to = f"{ROOT}/fleet/at/{at[0].split('/')[4]}"
            sent = [said[:STRANGER_LIMIT] for said in SAID.values() if said]
            for number, said in enumerate([*sent, bytes(1_000_000)]):
                other.put(
                    f"{to}/{number:016x}/{'5' * 16}",
                    said,
                    attachment=Header(SampleKind.DATA, 0, 0).pack(),
                    congestion_control=zenoh.CongestionControl.BLOCK,
                )
            eventually(lambda: len(arrived) == len(sent) * 4 and not any(each() for each in arrived), what="freed")
            assert strangers_of(server).used == 0
            assert strangers_of(server).turned_away == 1
    finally:
        bridge.close()
        router.close()
