"""Names of operators over networks that their tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

FLEET_KEPT = Place("rsb_extras.operators.zenoh_source", "_KEPT")
FLEET_MOST = Place("rsb_extras.operators.zenoh_source", "MOST")
