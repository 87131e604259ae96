"""The man page says all that the parser knows, and groff reads it without a complaint."""

from __future__ import annotations

import runpy
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.support.captured import captured
from tests.support.commands import options_of, parser_and_commands, subcommands_of

from rsb_bridge.feature import BRINGS_COMMANDS

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

_DOCS = Path(__file__).parents[2] / "docs"
_PAGE = _DOCS / "rsb-console.1"


def said(parser: argparse.ArgumentParser, name: str) -> Iterator[str]:
    for action in options_of(parser):
        yield from action.option_strings
    for word, each in subcommands_of(parser).items():
        yield f"{name} {word}"
        yield from said(each, f"{name} {word}")


@pytest.mark.skipif(bool(BRINGS_COMMANDS.keys() - parser_and_commands()[1]), reason="the core alone")
def test_it_is_up_to_date() -> None:
    page = runpy.run_path(str(_DOCS / "manpage.py"))["page"]()
    assert _PAGE.read_text(encoding="utf-8") == page, "make man"


def test_every_command_and_option_is_in_it() -> None:
    text = _PAGE.read_text(encoding="utf-8").replace("\\-", "-")
    everything = set(said(parser_and_commands()[0], "rsb-console"))
    assert len(everything) > 80
    assert [each for each in everything if each not in text] == []
    assert "%(" not in text


def test_every_command_takes_what_the_page_says() -> None:
    def leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
        nested = subcommands_of(parser).values()
        yield from (leaf for each in nested for leaf in leaves(each)) if nested else (parser,)

    commands = list(leaves(parser_and_commands()[0]))
    assert len(commands) > 30
    for command in commands:
        names = {name for action in options_of(command) for name in action.option_strings}
        assert {"--help", "--debug"} <= names, command.prog


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")
def test_groff_takes_it() -> None:
    run = captured("groff", "-man", "-Tutf8", "-ww", "-K", "utf8", "-P-cbou", _PAGE)
    assert run.stderr == ""
    assert "rsb-console keygen" in run.stdout
