"""Completes names of managed nodes and of groups."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.command.completion import asked_of_bridge
from rsb_console.feature_console import result
from rsb_extras.node_control.change_requests import ListManaged

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_bridge.feature_api import RemoteEngine


def target_names(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the groups and managed nodes of both sides of a bridge."""

    def names(engine: RemoteEngine) -> list[str]:
        sides = [side.managed for side in result(engine.do(ListManaged()))]
        return [each.name for side in sides for each in side.targets]

    return asked_of_bridge(parsed_args, names)
