"""Names of the fleet that its tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

ROBOTS = Place("rsb_extras.fleet.server_source", "ServerFleet.robots")
DEMO_LOOK_EVERY = Place("rsb_extras.fleet.fleet_demo", "_LOOK_EVERY")
TELL_STEP = Place("rsb_extras.fleet.rollout", "RolloutScreen._tell")
