"""Names of the feature that its tests replace."""

from __future__ import annotations

from tests.support.places import Place

SYSTEM_UNITS = Place("rsb_extras.service.systemd_service", "_SYSTEM_UNITS")
PROGRAM_ARGUMENTS = Place("rsb_extras.service.systemd_service", "sys.argv")
