"""The line on what is rewritten, among a topic's details and in ``info``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import RouteFact
from rsb_extras.frames import REWRITTEN

if TYPE_CHECKING:
    from rsb_bridge.feature_api import RouteSnapshot


class FrameLine(Wording):
    PREFIX = "{prefix} is put before its frames"
    RESTAMPS = "its stamps are shifted to this machine's clock"


def _line(route: RouteSnapshot) -> str:
    rewriting = REWRITTEN.of(route)
    parts = [FrameLine.PREFIX(prefix=rewriting.prefix)] if rewriting.prefix else []
    return "; ".join([*parts, *([FrameLine.RESTAMPS()] if rewriting.restamps else [])])


FACT = RouteFact("Rewritten", _line)
