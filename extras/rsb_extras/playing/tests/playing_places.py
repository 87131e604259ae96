"""Names of the player that tests replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

LATCHED_BYTES = Place("rsb_extras.playing.latched_room", "LATCHED_BYTES")
