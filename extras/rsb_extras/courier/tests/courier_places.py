"""Names of the courier that tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

ENCODED_PIECE = Place("rsb_extras.courier.link_courier", "encode_piece")
CUTTER = Place("rsb_extras.courier.link_courier", "_cutter")
LIST_PAGE = Place("rsb_extras.courier.link_courier", "LinkCourier._page")
BEGINNING = Place("rsb_extras.courier.kept_recordings", "_beginning")
QUICK = Place("rsb_extras.courier.kept_recordings", "_QUICK")
FOLLOWS = Place("rsb_extras.courier.fetch_spool", "check_follows")
LEFT_FREE = Place("rsb_extras.courier.fetch_spool", "_LEFT_FREE")
MOST_COMPARED = Place("rsb_extras.courier.message_index", "MOST_MESSAGES")
LISTED_WITHIN = Place("rsb_extras.courier.courier_part", "LISTED_WITHIN")
ANSWERED_WITHIN = Place("rsb_console.command.target", "ANSWERED_WITHIN")
WAITED_WITHIN = Place("rsb_extras.courier.courier_command", "LISTED_WITHIN")
BOUNDED_EACH = Place("rsb_extras.courier.courier_part", "_BOUNDED_EACH")
DISK_AGAIN_AFTER = Place("rsb_extras.courier.courier_part", "_DISK_AGAIN_AFTER")
