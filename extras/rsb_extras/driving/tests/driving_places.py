"""Names of driving that its tests replace."""

from __future__ import annotations

from tests.support.places import Place

DRIVE_STOOD_STILL = Place("rsb_extras.driving.steering", "_STOOD_STILL")
DRIVE_TIME = Place("rsb_extras.driving.drive_screen", "time")
ENDS_AFTER = Place("rsb_extras.driving.publishing", "ENDS_AFTER")
MATCHED_WITHIN = Place("rsb_extras.driving.publishing", "MATCHED_WITHIN")
RESOLVE_EVERY = Place("rsb_extras.driving.publishing", "_RESOLVE_EVERY")
TICKET_LIFE = Place("rsb_extras.driving.publishing", "TICKET_LIFE")
READ_FIELDS = Place("rsb_extras.driving.publishing", "read_fields")
PUB_PUBLISH = Place("rsb_extras.driving.pub_command", "publish")
PUB_TIME = Place("rsb_extras.driving.pub_command", "time")
