"""Names of node control that tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

TICKET_LIFE = Place("rsb_bridge.link.orders", "TICKET_LIFE")
MANAGED_NAMES = Place("rsb_extras.node_control.node_changer", "managed_names")
ASKED_WITHIN = Place("rsb_bridge.link.orders", "ASKED_WITHIN")
WORK = Place("rsb_extras.node_control.node_changer", "NodeChanger._work")
ARMED = Place("rsb_extras.node_control.node_changer", "armed_of_nodes")
