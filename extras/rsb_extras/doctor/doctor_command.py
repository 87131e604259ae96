"""The command ``doctor``: examines this machine and its terminal, and names a remedy for what is wrong."""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from functools import partial
from typing import TYPE_CHECKING, Any

from rsb_bridge.feature_api import Check, Finding, Grade, SessionError, load, plural
from rsb_bridge.model.finding import examine, worst
from rsb_console.command.check import print_mistakes
from rsb_console.feature_console import FAILURE, OK, json_line, print_line
from rsb_console.notation.ascii_signs import prefers_ascii
from rsb_extras.doctor import machine, ros_setup, session_needs
from rsb_extras.doctor.operator_line import line_check

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

_WORDS = {Grade.WARNING: "WARNING", Grade.ERROR: "ERROR"}
_NOUNS = {Grade.ERROR: "error", Grade.WARNING: "warning"}
_INDENT = 25
_REMEDY = " " * 9 + "> "
_NARROW, _WIDE = 60, 120  # columns between which the lines follow the terminal: round figures
_SMALLEST_TERMINAL = (80, 24)


def doctor(arguments: Namespace) -> int:
    """Examine this machine, and what a session needs of it."""
    path: Path | None = arguments.session
    try:
        session = None if path is None else load(path)
    except SessionError as error:
        return print_mistakes(error)
    own_domain = None if session is None else session.domain_id
    checks = [*ros_setup.checks(os.environ, own_domain=own_domain), *machine.checks(os.environ)]
    checks += [terminal_check(os.environ), line_check(os.environ)]
    if session is not None and path is not None:
        checks += session_needs.checks(session, path, os.environ)
    found = list(examine(checks))
    if arguments.json:
        print_line(json_line({"ok": worst(found) != Grade.ERROR, **report(found)}))
    else:
        for line in lines(found, shutil.get_terminal_size().columns):
            print_line(line)
    return FAILURE if worst(found) == Grade.ERROR else OK


def terminal_check(environ: Mapping[str, str]) -> Check:
    """Return the check of the terminal of standard output."""
    return Check("terminal", "terminal", partial(_terminal, environ))


def _terminal(environ: Mapping[str, str]) -> Iterator[Finding]:
    if not sys.stdout.isatty():
        yield Finding("terminal", Grade.OK, "terminal", "standard output is not a terminal")
        return
    term, size, plain = environ.get("TERM", ""), shutil.get_terminal_size(), prefers_ascii(environ)
    true_colour = environ.get("COLORTERM", "") in {"truecolor", "24bit"}
    colours = "24-bit colours" if true_colour else "256 colours" if "256" in term else "16 colours"
    program = "tmux" if environ.get("TMUX") else "screen" if environ.get("STY") else ""
    facts = {"term": term, "columns": size.columns, "lines": size.lines, "colours": colours, "ascii": plain}
    if term in {"", "dumb"}:
        text, remedy = f"TERM is {term!r}: the console cannot draw there", "export TERM=xterm-256color"
        yield Finding("terminal", Grade.WARNING, "terminal", text, remedy, facts)
        return
    signs = f"{'ASCII' if plain else 'Unicode'} signs{program and f', inside {program}'}"
    text, grade = f"{term}, {size.columns} × {size.lines}, {colours}, {signs}", Grade.NOTE if plain else Grade.OK
    remedy = "export LC_ALL=C.UTF-8, if the terminal shows Unicode" if plain else ""
    yield Finding("terminal", grade, "terminal", text, remedy, facts)
    if size.columns < _SMALLEST_TERMINAL[0] or size.lines < _SMALLEST_TERMINAL[1]:
        text = f"the console needs {_SMALLEST_TERMINAL[0]} × {_SMALLEST_TERMINAL[1]} at least"
        yield Finding("terminal_size", Grade.WARNING, "terminal", text, facts=facts)


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
