"""Fleet: all robots of some servers, or of a network, on one screen, and commands for some of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Mapping

    from rsb_console.feature_console import Action, AddCommand, Complete


class FleetFeature(Feature):
    name = "fleet"
    needs = ("demo",)

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_extras.fleet.fleet_arguments import add_fleet_commands  # noqa: PLC0415 -- `Feature` says why

        add_fleet_commands(add, complete)

    def options(self, commands: Mapping[str, argparse.ArgumentParser], complete: Complete) -> None:
        from rsb_extras.fleet.fleet_arguments import add_demo_options, say_what_runs  # noqa: PLC0415

        add_demo_options(commands["demo"])
        say_what_runs(commands)

    def screens(self) -> Iterable[tuple[Action, ...]]:
        from rsb_extras.fleet.fleet_actions import FLEET_ACTIONS  # noqa: PLC0415

        return (FLEET_ACTIONS,)


FEATURE = FleetFeature()
