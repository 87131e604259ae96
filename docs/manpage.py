"""Writes the man page, from what the parser of the command knows: `make man`."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_console.command.arguments import EPILOG, parser_and_commands

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

PAGE = Path(__file__).parent / "rsb-console.1"
_OF_ALL = ("help", "debug")
_FILES = """\
.SH FILES
.TP
.I session.yaml
What a bridge does; the documentation of the project lists its keys.
.TP
.I ~/.config/rsb-console
Themes and keys of the user.
.TP
.IR ~/.local/state/rsb-console ", " /var/lib/rsb-console
What bridges have reported, and the last 24 hours of their links and topics; crash.log.
.SH SEE ALSO
.BR ros2 (1),
.BR systemctl (1)
"""


def page() -> str:
    """The whole page, in the macros of man(7)."""
    parser, _ = parser_and_commands()
    lines = [
        '.TH RSB-CONSOLE 1 "" "rsb-console" "User Commands"',
        ".SH NAME",
        f"rsb-console \\- {_text(str(parser.description)[0].lower() + str(parser.description)[1:].rstrip('.'))}",
        ".SH SYNOPSIS",
        ".B rsb-console",
        r"[\fICOMMAND\fR] [\fIOPTION\fR]... [\fIARGUMENT\fR]...",
        ".SH DESCRIPTION",
        _text(EPILOG.partition("\n\n")[0].replace("`", "")),
        ".SH OPTIONS",
        r"Every command takes \-\-help and \-\-debug, too.",
        *_arguments(parser),
        ".SH COMMANDS",
        *_commands(parser, "rsb-console"),
        ".SH EXIT STATUS",
        *_preformatted(EPILOG.partition("\n\n")[2].partition("\n")[2]),
    ]
    return "\n".join(lines) + "\n" + _FILES


def _commands(parser: argparse.ArgumentParser, name: str) -> Iterator[str]:
    for action in parser._actions:
        if isinstance(action.choices, dict):
            for word, command in action.choices.items():
                yield f".SS {_text(f'{name} {word}')}"
                yield _text(str(command.description))
                yield from _arguments(command, leave_out=_OF_ALL)
                if command.epilog:
                    yield from _preformatted(command.epilog)
                yield from _commands(command, f"{name} {word}")


def _arguments(parser: argparse.ArgumentParser, leave_out: tuple[str, ...] = ()) -> Iterator[str]:
    for action in parser._actions:
        if isinstance(action.choices, dict) or action.dest in leave_out:
            continue
        yield ".TP"
        yield _named(action)
        yield _text(str(action.help or "") % {"default": action.default})


def _named(action: argparse.Action) -> str:
    metavar = action.metavar[0] if isinstance(action.metavar, tuple) else action.metavar
    value = metavar or "|".join(map(str, action.choices or ())) or action.dest.upper()
    if not action.option_strings:
        return rf"\fI{_text(value)}\fR"
    names = ", ".join(rf"\fB{_text(each)}\fR" for each in action.option_strings)
    return names if action.nargs == 0 else rf"{names} \fI{_text(value)}\fR"


def _preformatted(text: str) -> list[str]:
    return [".PP", ".nf", *map(_text, text.rstrip().splitlines()), ".fi"]


def _text(text: str) -> str:
    """Text that groff takes as it is: no escapes, no macros, and hyphens that can be copied."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-").replace("~", r"\(ti").replace("^", r"\(ha")
    return re.sub(r"(?m)^(?=[.'])", r"\\&", escaped)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")
