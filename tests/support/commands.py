"""The command `rsb-console` in the test's own process: a process of its own takes much longer to start."""

from __future__ import annotations

import contextlib
import io
import json
import re
import signal
import subprocess
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced

from rsb_console import cli
from rsb_console.command import arguments

if TYPE_CHECKING:
    import argparse

parser_and_commands = cache(arguments.parser_and_commands)


def options_of(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """Return the arguments of a command, and what takes the names of its subcommands, which argparse lists nowhere."""
    return parser._actions


def subcommands_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    return next((action.choices for action in options_of(parser) if isinstance(action.choices, dict)), {})


class Ran:
    def __init__(self, capsys: pytest.CaptureFixture[str], *words: str) -> None:
        parsed = parser_and_commands()[0].parse_args(words)
        self.words = words
        self.code = parsed.command(parsed)
        self.out, self.err = capsys.readouterr()

    def __repr__(self) -> str:
        return f"Ran(code={self.code}, err={self.err!r}, out={self.out!r})"

    @property
    def json(self) -> Any:
        """The output, one object, with keys that docs/headless.md lists."""
        found = json.loads(self.out)
        if "--json" in self.words and isinstance(found, dict):
            assert isinstance(found.get("ok"), bool) or self.words[0] in ONE_A_LINE, found
            assert found.keys() <= documented_keys(self.words[0]), found.keys() - documented_keys(self.words[0])
        return found


ONE_A_LINE = ("events", "echo", "hz", "bw")
_HEADLESS = Path(__file__).parents[2] / "docs" / "headless.md"


def documented_keys(command: str) -> set[str]:
    """Return the keys of a command's object of JSON, and the codes in the same rows."""
    return set[str]().union(*(keys for names, keys in _documented() if command in names or "any" in names))


def documented_commands() -> set[str]:
    """Return the commands that have a row of their own."""
    return set[str]().union(*(names for names, _ in _documented()))


@cache
def _documented() -> list[tuple[set[str], set[str]]]:
    text = _HEADLESS.read_text(encoding="utf-8")
    table = text.partition("### Objects of the commands\n")[2].partition("\n#")[0]
    fleet = text.partition("### A robot of a fleet\n")[2].partition("\n|")[0]
    rows = [(first, keys) for first, _, keys in re.findall(r"^\| ([^|]+) (\|) (.+)\|$", table, re.MULTILINE)]
    rows += [
        ("`info`", _section(text, "A route") + _section(text, "A route of calls")),
        ("`events`", _section(text, "An event")),
        ("`fleet`", fleet),
    ]
    return [(set(re.findall(r"\w[\w-]*", each)), set(re.findall(r"`(\w+)`", keys))) for each, keys in rows]


def _section(text: str, heading: str) -> str:
    return text.partition(f"### {heading}\n")[2].partition("\n#")[0]


def rsb_console(*words: str, may_crash: bool = False) -> subprocess.CompletedProcess[str]:
    """Run the program from its arguments to its exit code, wrong usage included.

    Args:
        may_crash: report an unexpected exception as the program does, instead of raising it here.
    """

    def raise_again(error: Exception, **_: object) -> None:
        raise error

    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2))
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        replaced.ALLOW_MANY_DESCRIPTORS.set(patch, lambda: None)  # of the test's process
        if not may_crash:
            replaced.UNEXPECTED.set(patch, raise_again)
            replaced.ARGUMENT_PARSER.set(patch, parser_and_commands)
        try:
            code = cli.main(words)
        except SystemExit as ended:
            code = int(ended.code or 0)
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
    printed = [stream.buffer.getvalue().decode() for stream in (out, err)]
    return subprocess.CompletedProcess(words, code, *printed)
