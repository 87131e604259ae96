"""Names of driving that its tests replace."""

from __future__ import annotations

from tests.support.places import Place

STOOD_STILL = Place("rsb_extras.driving.drive_screen", "_STOOD_STILL")
TIME = Place("rsb_extras.driving.drive_screen", "time")
