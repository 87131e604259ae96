"""Names of the ring on disk that tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

LOOKS_EVERY = Place("rsb_extras.disk_ring.also_topics", "_LOOKS_EVERY")
