"""`rsb-console report`: what happened in the last hours, of a bridge that runs, or else from its files."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.control.bridges import running_bridges
from rsb_bridge.history import history_files
from rsb_bridge.history.history_files import HistoryFileError
from rsb_bridge.history.state_folder import EVENTS, Files, kept_bridges
from rsb_console.command.shell import OK, print_line, print_lines
from rsb_console.command.target import NoBridgeError, UsageError, ask_history, reported
from rsb_console.session.history import csv_report, json_report, parse_span, text_report

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_bridge.model.history import HistoryReport


def run(arguments: Namespace) -> int:
    """Print it. Returns the exit code."""
    return reported(_print, arguments)


def _print(arguments: Namespace) -> int:
    try:
        seconds = parse_span(arguments.last)
    except ValueError as error:
        raise UsageError(f"--last {error}") from None
    report = _report(arguments, seconds)
    if arguments.json:
        print_line(json_report(report))
    elif arguments.csv:
        print_lines(csv_report(report).removesuffix("\r\n"))
    else:
        for line in text_report(report):
            print_line(line)
    return OK


def _report(arguments: Namespace, seconds: float) -> HistoryReport:
    """The report of the bridge that the arguments mean.

    Raises:
        NoBridgeError: none runs, and none has left files.
        UsageError: several do, and the arguments do not say which.
    """
    name = arguments.bridge
    named = arguments.control is not None or arguments.fleet is not None
    if named or any(name in (None, bridge.name) for bridge in running_bridges()):
        return ask_history(arguments, seconds)
    if name is not None and (os.sep in name or name.endswith(EVENTS)):
        path = Path(name)
        kept = [Files(path.parent, path.name.partition(".")[0])]
    else:
        kept = [files for files in kept_bridges(os.environ) if name in (None, files.stem)]
    if not kept:
        which = "" if name is None else f" named {name!r}"
        raise NoBridgeError(f"no bridge{which} runs here, and none has left its files where you may read them")
    if len(kept) > 1:
        found = "".join(f"\n  {files.stem}: {files.history}" for files in kept)
        raise UsageError(f"no bridge runs here, and several have left their files; say which:{found}")
    try:
        return history_files.report(kept[0], time.time(), seconds)
    except HistoryFileError as error:
        raise NoBridgeError(str(error)) from None
