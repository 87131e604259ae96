"""Completes names of units."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.command.completion import asked_of_bridge
from rsb_console.feature_console import result
from rsb_extras.units.unit_requests import ListUnits

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_bridge.feature_api import RemoteEngine


def unit_names(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the units of both sides of a bridge."""

    def names(engine: RemoteEngine) -> list[str]:
        return [unit.name for group in result(engine.do(ListUnits())) for unit in group.units]

    return asked_of_bridge(parsed_args, names)
