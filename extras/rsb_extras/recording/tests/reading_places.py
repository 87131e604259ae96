"""Names of the readers that their tests replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

HELD = Place("rsb_extras.recording.reading.open_recording", "_HELD")
TOGETHER = Place("rsb_extras.recording.reading.open_recording", "_TOGETHER")
