"""The console's forms and details of a link over Zenoh: no ports, and its own two protocols."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.console.scripted import SESSION, route

from rsb_bridge.model.session import ZenohSettings
from rsb_console.screens.topic_form import KINDS, fields_by_kind
from rsb_console.session.draft import Ends
from rsb_console.widgets.columns import via

if TYPE_CHECKING:
    from rsb_bridge.model.session import Kind

OVER_ZENOH = msgspec.structs.replace(
    SESSION, server_ip="zenoh", server_port=0, zenoh=ZenohSettings(connect=("tcp/hub:7447",))
)


@pytest.mark.parametrize("kind", KINDS)
def test_a_form_offers_no_port_and_what_zenoh_has(kind: Kind) -> None:
    fields = fields_by_kind(OVER_ZENOH, Ends(is_server=False, client="robot1", use_name=False), None)[kind]
    assert "port" not in fields
    offered = {value for value, _ in fields["protocol"].options}
    assert offered == ({"", "zenoh", "zenoh-drop"} if kind == "topic" else {"", "zenoh"})


def test_the_column_has_room_for_both() -> None:
    for transport in ("zenoh", "zenoh-drop"):
        assert len(via(route("/scan", transport=transport))) <= 7
