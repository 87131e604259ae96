"""Names of nodes that tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

ANSWERED_WITHIN = Place("rsb_extras.nodes.link_nodes", "_ANSWERED_WITHIN")
LOOKED_FOR = Place("rsb_extras.nodes.link_nodes", "LOOKED_FOR")
AGED = Place("rsb_extras.nodes.node_rows", "_AGED")
