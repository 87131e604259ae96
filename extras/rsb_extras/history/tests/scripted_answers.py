"""The history of the robot that `tests.console.scripted` plays."""

from __future__ import annotations

from dataclasses import replace

from tests.console.scripted import NOW

from rsb_bridge.model.snapshot import Event, Level
from rsb_extras.history.history_data import HistoryReport, Outage, ReportHistory, Track

REMEMBERED = HistoryReport(
    "robot1", "client", NOW, 3600.0, True,
    (
        Track("robot1", "", False, 3370.0, 230.0, 1, (4e5,) * 40 + (None,) * 4 + (4e5,) * 4),
        Track("robot1", "/robot1/map", False, 3100.0, 500.0, 2, (1.0,) * 48),
        Track("robot1", "/robot1/scan", False, 3370.0, 230.0, 1, (10.0,) * 48),
    ),
    (
        Outage(NOW - 3000, 230.0, "robot1", "", False, "down", "the server does not answer"),
        Outage(NOW - 2999, 232.0, "robot1", "/robot1/map", False, "down", "no link", with_link=True),
        Outage(NOW - 2999, 232.0, "robot1", "/robot1/scan", False, "down", "no link", with_link=True),
        Outage(NOW - 268, 268.0, "robot1", "/robot1/map", False, "stale", "=nothing for 15 s", ongoing=True),
    ),
    (
        Event(0, NOW - 1200, Level.INFO, "route.paused", "/robot1/odom: paused", "robot1", "/robot1/odom", "anna"),
        Event(0, NOW - 600, Level.INFO, "topic.edited", "/robot1/scan: edited", "robot1", "/robot1/scan", "anna",
              "max_rate: 5", "max_rate: 2"),
    ),
)  # fmt: skip


def answer(command: ReportHistory, report: HistoryReport = REMEMBERED) -> HistoryReport:
    whole = replace(report, span=command.seconds)
    return whole.of_link(command.link) if command.link else whole


ANSWERS = {ReportHistory: answer}
