"""Every command line of the documents is one that the command takes."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

from rsb_console.command.arguments import parser_and_commands

if TYPE_CHECKING:
    from collections.abc import Iterator

_ROOT = Path(__file__).parents[2]
_PAGES = [_ROOT / "README.md", _ROOT / "SECURITY.md", *sorted((_ROOT / "docs").glob("*.md"))]
_SEPARATORS = frozenset(("|", "&&", "||", ";", "&", ">", ">>", "<"))
_PLACEHOLDERS = {"SHELL": "bash"}


class Line(NamedTuple):
    """A command line of a page.

    Attributes:
        whole: whether it stands in a block, so that readers copy it. In a sentence it may lack arguments.
    """

    place: str
    words: list[str]
    whole: bool


def lines() -> Iterator[Line]:
    for page in _PAGES:
        in_block = False
        for number, text in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            place = f"{page.relative_to(_ROOT)}:{number}"
            if text.lstrip().startswith("```"):
                in_block = not in_block
            elif in_block:
                yield from (Line(place, words, True) for words in commands(text))
            else:
                for code in re.findall(r"`(rsb-console [^`]+)`", text):
                    yield from (Line(place, words, False) for words in commands(code))


def commands(text: str) -> Iterator[list[str]]:
    """The arguments of each call of `rsb-console` in a line of shell."""
    if not re.search(r"(^|[\s(])rsb-console\s", text):
        return
    text = re.sub(r"\w+=\$\((.*?)\)$", r"\1", text.strip().removeprefix("$ "))
    splitter = shlex.shlex(text, posix=True, punctuation_chars="|&;<>")
    splitter.whitespace_split = True
    splitter.commenters = "#"
    words: list[str] = []
    for word in [*splitter, ";"]:
        if word not in _SEPARATORS:
            words.append(_PLACEHOLDERS.get(word, word))
            continue
        if words and words[0] == "rsb-console":
            yield words[1:]
        words = []


FOUND = [*lines()]


def test_they_are_found() -> None:
    assert len(FOUND) > 60
    assert [*commands("rsb-console wait --for flowing /scan && ros2 topic list  # then")] == [
        ["wait", "--for", "flowing", "/scan"]
    ]
    assert [*commands("goal=$(rsb-console call /a '{b: c d}' --json | jq -r .id)")] == [
        ["call", "/a", "{b: c d}", "--json"]
    ]


@pytest.mark.parametrize("line", FOUND, ids=[f"{line.place} {line.words[0]}" for line in FOUND])
def test_it_is_taken(line: Line, capsys: pytest.CaptureFixture[str]) -> None:
    parser, names = parser_and_commands()
    words = line.words
    if words[0].startswith("-"):
        assert words[0] in parser.format_help()
        return
    if words[0] not in names:  # rsb-console SESSION
        words = ["run", *words]
    try:
        parser.parse_args(words)
    except SystemExit:
        error = capsys.readouterr().err
        assert not line.whole, error
        assert "the following arguments are required" in error, error
