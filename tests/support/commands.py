"""The command `rsb-console` in the test's own process: a process of its own takes much longer to start."""

from __future__ import annotations

import json
from functools import cache
from typing import TYPE_CHECKING, Any

from rsb_console.command import arguments

if TYPE_CHECKING:
    import pytest

parser_and_commands = cache(arguments.parser_and_commands)


class Ran:
    """The result of a command.

    Attributes:
        code: exit code.
        out: standard output.
        err: standard error.
    """

    def __init__(self, capsys: pytest.CaptureFixture[str], *words: str) -> None:
        parsed = parser_and_commands()[0].parse_args(words)
        self.code = parsed.command(parsed)
        self.out, self.err = capsys.readouterr()

    @property
    def json(self) -> Any:
        """The output, one object."""
        return json.loads(self.out)
