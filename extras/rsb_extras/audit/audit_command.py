"""The command ``audit``: compares two recordings, and fails if something that QoS promises is missing."""

from __future__ import annotations

import sqlite3
from typing import TYPE_CHECKING

import msgspec

from rsb_console.feature_console import FAILURE, OK, UsageError, json_line, print_line
from rsb_extras.audit.audit_table import AuditText, lines_of
from rsb_extras.audit.comparing import AuditOptions, compare
from rsb_extras.audit.topic_pairs import PairError
from rsb_extras.recording.reading.stored_message import RecordingError

if TYPE_CHECKING:
    from argparse import Namespace


def audit(arguments: Namespace) -> int:
    options = AuditOptions(
        arguments.topic,
        arguments.pair,
        arguments.back,
        arguments.forth,
        arguments.offset,
        arguments.gap,
        arguments.overlap,
    )
    try:
        report = compare(arguments.near, arguments.far, options)
    except (RecordingError, PairError) as error:
        raise UsageError(str(error)) from None
    except sqlite3.OperationalError as error:
        raise UsageError(AuditText.NO_ROOM(reason=error)) from None
    if arguments.json:
        print_line(json_line({"ok": not report.breaches, **msgspec.to_builtins(report)}))
    else:
        for line in lines_of(report):
            print_line(line)
    return FAILURE if report.breaches else OK
