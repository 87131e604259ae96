"""History: what happened in the last 24 hours, on a screen, as a report, and in files that outlive the bridge."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.engine.engine import Engine
    from rsb_bridge.feature_api import Command, EngineObserver, Event
    from rsb_console.feature_console import Action, AddCommand, Complete


class History(Feature):
    name = "history"

    def commands(self) -> Iterable[type[Command[object]]]:
        from rsb_extras.history.history_data import ReportHistory  # noqa: PLC0415 -- `Feature` says why, here and below

        return (ReportHistory,)

    def observers(self, engine: Engine) -> Iterable[EngineObserver]:
        from rsb_extras.history.keeper import HistoryKeeper  # noqa: PLC0415

        return (HistoryKeeper(engine),)

    def kept_logs(self, name: str) -> Iterable[Iterable[Event]]:
        from rsb_extras.history.bridge_files import files_of  # noqa: PLC0415
        from rsb_extras.history.history_files import read_events  # noqa: PLC0415

        return (read_events(files.events, 0.0) for files in files_of(name, os.environ))

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_console.feature_console import EXIT, named_bridge_options, subcommand  # noqa: PLC0415

        summary = "print the history of the last hours, even of a bridge that has ended"
        report = add("report", subcommand("rsb_extras.history.report_command:report"), summary, EXIT, after="events")
        named_bridge_options(report, complete)
        span = "time span: 8h, 30m, ...; at most 24h (%(default)s)"
        report.add_argument("--last", default="8h", metavar="SPAN", help=span)
        report.add_argument("--csv", action="store_true", help="print CSV, for a spreadsheet")

    def actions(self) -> Iterable[Action]:
        from rsb_console.feature_console import Action, Group, late  # noqa: PLC0415

        return (
            Action(
                "history", "h", "history", "Show the last hours: outages, and what operators did", Group.SESSION,
                in_footer=True, run=late("rsb_extras.history.history_screen:show_history"), after="links",
            ),
        )  # fmt: skip


FEATURE = History()
