"""Names of the Zenoh transport that its tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

ASKED_WITHIN = Place("rsb_extras.zenoh.endpoint", "ASKED_WITHIN")
MOST_SEEN = Place("rsb_extras.zenoh.endpoint", "MOST_SEEN")
RECEIVE_BUFFER = Place("rsb_extras.zenoh.endpoint", "RECEIVE_BUFFER")
ADDRESS = Place("rsb_extras.zenoh.endpoint", "_ADDRESS")
AT_A_TIME = Place("rsb_extras.zenoh.endpoint", "_AT_A_TIME")
CONFIRMED = Place("rsb_extras.zenoh.endpoint", "_CONFIRMED")
OVERHEAD = Place("rsb_extras.zenoh.endpoint", "_OVERHEAD")
STRANGERS_AT_A_TIME = Place("rsb_extras.zenoh.endpoint", "_STRANGERS_AT_A_TIME")
STRANGERS_WAIT = Place("rsb_extras.zenoh.endpoint", "_STRANGERS_WAIT")
LOOK_WITHIN = Place("rsb_extras.zenoh.unreachable", "_WITHIN")
RECEIVE = Place("rsb_extras.zenoh.endpoint", "ZenohEndpoint._receive")
RECEIVE_DATAGRAM = Place("rsb_extras.zenoh.endpoint", "ZenohEndpoint._receive_datagram")
WITHIN_BUDGET = Place("rsb_extras.zenoh.endpoint", "ZenohEndpoint._within_budget")
ASK = Place("rsb_extras.zenoh.endpoint", "ZenohEndpoint.ask")
REACH = Place("rsb_extras.zenoh.network", "reach")
OPEN_ZENOH = Place("zenoh", "open")
