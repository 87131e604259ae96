"""`rsb-console report`: the history of a bridge that runs, or of one that has ended, from its files."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording, running_bridges
from rsb_bridge.installed_features import added
from rsb_console.feature_console import OK, NoBridgeError, UsageError, attached, print_line, print_lines, result
from rsb_extras.history import history_files
from rsb_extras.history.bridge_files import EVENTS, Files, kept_bridges
from rsb_extras.history.history_data import ReportHistory
from rsb_extras.history.history_files import HistoryFileError
from rsb_extras.history.history_report import csv_report, json_report, parse_span, text_report

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_extras.history.history_data import HistoryReport

_WIDTH = 100  # columns of findings about the machine: a round figure


class ReportProblem(Wording):
    """Reasons why there is no report, and the headline of its last part."""

    OPERATOR_MACHINE = "The machine of this command, {host}, now ({source}):"
    NOTHING_OF_BRIDGE = "no bridge named {name!r} runs here, and you may read no history file of that name"


def report(arguments: Namespace) -> int:
    try:
        seconds = parse_span(arguments.last)
    except ValueError as error:
        raise UsageError(f"--last {error}") from None
    history = _history(arguments, seconds)
    if arguments.csv and not arguments.json:
        print_lines(csv_report(history).removesuffix("\r\n"))
        return OK
    host = os.uname().nodename  # `platform.node` has the same name, but is one more module to load
    findings = added("machine", _WIDTH)
    if arguments.json:
        found = {key: value for each in findings for key, value in each.data.items()}
        print_line(json_report(history, operator_machine={"host": host, **found}))
        return OK
    for line in text_report(history):
        print_line(line)
    for each in findings:
        print_line("")
        print_line(ReportProblem.OPERATOR_MACHINE(host=host, source=each.source))
        for line in each.lines:
            print_line(line)
    return OK


def _history(arguments: Namespace, seconds: float) -> HistoryReport:
    """Return the history of the bridge that the arguments name.

    Raises:
        NoBridgeError: no bridge runs or has left history files.
        UsageError: the arguments leave several bridges to choose from.
    """
    name = arguments.bridge
    named = arguments.control is not None or arguments.way is not None
    # A bridge that runs is asked: its files may be two minutes old (the page on history).
    if named or any(name in (None, bridge.name) for bridge in running_bridges()):
        with attached(arguments, read_only=True) as engine:
            return result(engine.do(ReportHistory(seconds)))
    # This is a path to the bridge's files. One without a folder differs from a name by its ending only.
    if name is not None and (os.sep in name or name.endswith(EVENTS)):
        path = Path(name)
        kept = [Files(path.parent, path.name.partition(".")[0])]
    else:
        kept = [files for files in kept_bridges(os.environ) if name in (None, files.stem)]
    if not kept:
        if name is None:
            raise NoBridgeError("no bridge runs here, and there is no history file that you may read")
        raise NoBridgeError(ReportProblem.NOTHING_OF_BRIDGE(name=name))
    if len(kept) > 1:
        found = "".join(f"\n  {files.stem}: {files.history}" for files in kept)
        raise UsageError(f"no bridge runs here, but several have history files; choose one:{found}")
    try:
        return history_files.report(kept[0], time.time(), seconds)
    except HistoryFileError as error:
        raise NoBridgeError(str(error)) from None
