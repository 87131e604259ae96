"""The facts of the two transports over a Zenoh network."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import TransportTraits
from rsb_bridge.model.limits import NO_PORT
from rsb_bridge.model.transport_traits import Ages
from rsb_extras.zenoh import HOW_TO_INSTALL, ZENOH, ZENOH_HOST

if TYPE_CHECKING:
    from rsb_bridge.feature_api import Session


class ZenohTraits(TransportTraits):
    """Streams over a Zenoh network, each in samples that its routers hold back while it is congested."""

    name = "zenoh"
    medium = "Zenoh"
    chosen_by = "server_ip: zenoh"
    port_kind = "Zenoh port"
    ports = topic_ports = NO_PORT
    ip_ports = False
    companions = ("zenoh-drop",)
    best_effort = "zenoh-drop"
    # Zenoh takes all that the window allows, and puts it on one connection: small messages wait behind large ones, and
    # the more is in transit, the longer TCP waits before it tries again after a gap. With 0.3 s instead of 0.8, joint
    # states came after 0.15 s instead of 0.41 on a Wi-Fi (docs/design.md, 5).
    ages = Ages(0.1, 0.3, 0.15, 1.0)
    local = False

    @staticmethod
    def carries_links_to(host: str) -> bool:
        return host == ZENOH_HOST

    @classmethod
    def place(cls, session: Session) -> str:
        settings = ZENOH.of(session)
        if settings is None:
            return "over Zenoh"
        return f"in the fleet {settings.fleet}, over Zenoh ({settings.place})"

    @classmethod
    def missing(cls) -> str:
        return "" if importlib.util.find_spec("zenoh") else HOW_TO_INSTALL


class ZenohDropTraits(TransportTraits):
    """Single samples over a Zenoh network, which its routers drop while it is congested."""

    name = "zenoh-drop"
    short = "DROP"
    medium, chosen_by = ZenohTraits.medium, ZenohTraits.chosen_by
    port_kind = "Zenoh port"
    ports = topic_ports = NO_PORT
    ip_ports = False
    reliable = False
    delivery = "never waits for lost messages, as fits best effort"
    local = False
