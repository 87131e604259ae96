"""Names of the history that its tests replace."""

from __future__ import annotations

from tests.support.places import Place

HISTORY_FILE_BYTES = Place("rsb_extras.history.history_files", "FILE_BYTES")
SERVICES_STATE = Place("rsb_bridge.config.state_folder", "SERVICES")
MOST_TRACKS = Place("rsb_extras.history.timeline", "MOST_TRACKS")
WALK_TRACKS = Place("rsb_extras.history.timeline", "TrackRecords.items")
OUTAGES_KEPT = Place("rsb_extras.history.timeline", "OUTAGES")
