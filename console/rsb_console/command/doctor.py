"""The command ``doctor``: examines this machine, and names a remedy for what is wrong."""

from __future__ import annotations

import os
import shutil
import textwrap
from typing import TYPE_CHECKING, Any

from rsb_bridge.config.session_file import SessionError, load
from rsb_bridge.doctor import machine, ros_setup, session_needs
from rsb_bridge.doctor.finding import Finding, Grade, examine, worst
from rsb_bridge.model.text import plural
from rsb_console.command.check import print_mistakes
from rsb_console.command.formatting import json_line
from rsb_console.command.shell import FAILURE, OK, print_line

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from rsb_bridge.doctor.finding import Check

_WORDS = {Grade.WARNING: "WARNING", Grade.ERROR: "ERROR"}
_NOUNS = {Grade.ERROR: "error", Grade.WARNING: "warning"}
_INDENT = 25
_REMEDY = " " * 9 + "> "
_NARROW, _WIDE = 60, 120  # columns between which the lines follow the terminal: round figures


def run_doctor(path: Path | None, more: Iterable[Check], *, as_json: bool) -> int:
    """Examine this machine, and what a session needs of it."""
    try:
        session = None if path is None else load(path)
    except SessionError as error:
        return print_mistakes(error)
    own_domain = None if session is None else session.domain_id
    checks = [*ros_setup.checks(os.environ, own_domain=own_domain), *machine.checks(os.environ), *more]
    if session is not None and path is not None:
        checks += session_needs.checks(session, path, os.environ)
    found = list(examine(checks))
    if as_json:
        print_line(json_line(report(found)))
    else:
        for line in lines(found, shutil.get_terminal_size().columns):
            print_line(line)
    return FAILURE if worst(found) == Grade.ERROR else OK


def this_machine() -> list[Finding]:
    """Return the findings about this machine and its ROS."""
    return list(examine((*ros_setup.checks(os.environ), *machine.checks(os.environ))))


def report(findings: Iterable[Finding]) -> dict[str, Any]:
    """Return the findings as an object of JSON."""
    found = list(findings)
    return {"worst": str(worst(found)), "findings": [each.as_json() for each in found]}


def lines(findings: Iterable[Finding], columns: int) -> Iterator[str]:
    """Yield the findings as lines, the worst ones last, where a terminal shows them."""
    found = list(findings)
    width = min(max(columns, _NARROW), _WIDE) - 1
    for grade in Grade:
        for each in (one for one in found if one.grade == grade):
            head = f"{_WORDS.get(grade, str(grade)):<8} {each.subject:<{_INDENT - 9}}"
            yield from _wrapped(head, each.text, width)
            if each.remedy:
                yield f"{_REMEDY}{each.remedy}"  # not wrapped, so that it can be copied
    bad = [(sum(one.grade == grade for one in found), noun) for grade, noun in _NOUNS.items()]
    if any(count for count, _ in bad):
        yield ", ".join(f"{count} {plural(count, noun)}" for count, noun in bad if count)
    else:
        yield "nothing is wrong"


def _wrapped(head: str, text: str, width: int) -> list[str]:
    indent = " " * len(head)
    # Commands and paths in a text stay whole, so that they can be copied.
    return textwrap.wrap(
        text, width, initial_indent=head, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
