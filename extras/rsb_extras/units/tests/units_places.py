"""Names of units that tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

ASKED_WITHIN = Place("rsb_bridge.link.orders", "ASKED_WITHIN")
TICKET_LIFE = Place("rsb_bridge.link.orders", "TICKET_LIFE")
AGED = Place("rsb_console.screens.sides_screen", "_AGED")
EXECUTE = Place("rsb_extras.units.unit_runner", "UnitRunner._execute")
ARMED = Place("rsb_extras.units.unit_runner", "armed_of_nodes")
