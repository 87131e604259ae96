"""Demo: a simulated robot and its desk, bridged on this machine; and what plays fleets of robots for measuring."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_console.feature_console import Action, AddCommand, Complete


class DemoFeature(Feature):
    name = "demo"

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_console.feature_console import seconds, subcommand  # noqa: PLC0415 -- `Feature` says why

        summary = "bridge two ROS domains on this machine, with a simulated robot"
        parser = add("demo", subcommand("rsb_extras.demo.demo_command:demo"), summary, after="bt-scan")
        parser.add_argument("--no-ui", action="store_true", help="print the log, without the console")
        parser.add_argument("--seconds", type=seconds, metavar="N", help="stop after N s")

    def actions(self) -> Iterable[Action]:
        from rsb_console.feature_console import (  # noqa: PLC0415
            Action,
            Beginning,
            Group,
            late,
        )

        about = "a simulated robot, bridged on this machine"
        demo = Action(
            "demo", "f4", "demo", "Run the demo: a simulated robot on this machine", Group.SESSION,
            changes=True, after="new_session", run=late("rsb_extras.demo.another_demo:demo"),
            begins=Beginning("d", "Demo", about, 1, writes=False),
        )  # fmt: skip
        return (demo,)


FEATURE = DemoFeature()
