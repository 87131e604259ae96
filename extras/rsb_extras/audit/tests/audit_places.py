"""Names of the audit that its tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

ROWS_HELD = Place("rsb_extras.audit.recorded", "ROWS_HELD")
MATCHES_HELD = Place("rsb_extras.audit.matching", "ROWS_HELD")
PIECE = Place("rsb_extras.audit.matching", "_PIECE")
INSERTS = (Place("rsb_extras.audit.recorded", "insert"), Place("rsb_extras.audit.matching", "insert"))
CALLS_REMEMBERED = Place("rsb_extras.audit.unanswered", "_MOST")
NEW_DATABASE = Place("rsb_extras.audit.comparing", "new_database")
TOPICS = Place("rsb_extras.audit.recorded", "_TOPICS")
