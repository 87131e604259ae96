"""Doctor: examines a machine, its ROS and what a session needs, and names a remedy for what is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Feature, MachineReport

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.feature_api import Check, Finding
    from rsb_console.feature_console import AddCommand, Complete


class Doctor(Feature):
    name = "doctor"

    def machine(self, columns: int) -> Iterable[MachineReport]:
        from rsb_extras.doctor.doctor_command import lines, report, this_machine  # noqa: PLC0415 -- `Feature` says why

        found = this_machine()
        return (MachineReport(report(found), "rsb-console doctor", tuple(lines(found, columns))),)

    def checks(self) -> Iterable[Check]:
        from rsb_bridge.feature_api import Check  # noqa: PLC0415

        def features() -> Iterable[Finding]:
            from rsb_extras.doctor.feature_check import features  # noqa: PLC0415 -- loads what a console does

            return features()

        return (Check("features", "features", features),)

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from pathlib import Path  # noqa: PLC0415

        from rsb_console.feature_console import subcommand  # noqa: PLC0415

        summary = "examine this machine: ROS, network, memory, clock, terminal"
        doctor = add("doctor", subcommand("rsb_extras.doctor.doctor_command:doctor"), summary, after="check")
        needs = "also examine what this session needs"
        complete(doctor.add_argument("session", type=Path, metavar="SESSION", nargs="?", help=needs), "yaml_files")
        doctor.add_argument("--json", action="store_true", help="print JSON, for programs")


FEATURE = Doctor()
