"""What terminals tell of themselves, as xterm 379, kitty 0.26, urxvt 9.30, PuTTY 0.78, tmux 3.3 and screen 4.9 do."""

from __future__ import annotations

from functools import reduce

import pytest
from textual.events import Key

from rsb_console.terminal.driver import KeyParser
from rsb_console.terminal.terminal_facts import TRUE_COLOUR, TerminalFacts, is_answer, may_become_answer

UNKNOWN = TerminalFacts(colours=16)
XTERM = (
    "P>|XTerm(379)\x1b\\",
    "]4;200;rgb:ffff/0000/d7d7\x07",
    "P1$r0;48:2::1:2:3m\x1b\\",
    "[6;19;8t",
    "[?64;1;2;6;9;15;16;17;18;21;22;28c",
)
KITTY = ("P>|kitty(0.26.5)\x1b\\", "[6;18;9t", "_Gi=31;OK\x1b\\", "[?62;c")


def told(*answers: str) -> TerminalFacts:
    return reduce(TerminalFacts.told, answers, UNKNOWN)


def test_xterm_tells_true_colours() -> None:
    assert told(*XTERM) == TerminalFacts("XTerm(379)", "", TRUE_COLOUR, (8, 19), "", None, answered=True)


def test_kitty_shows_pixels_of_its_own() -> None:
    facts = told(*KITTY)
    assert (facts.pixels, facts.cell, facts.shape, facts.draws_sextants) == ("kitty", (9, 18), 2.0, True)


@pytest.mark.parametrize(
    ("answer", "changed"),
    [
        ("[?62;4;22c", {"pixels": "sixel", "answered": True}),
        ("[?6c", {"answered": True}),
        ("_Gi=31;ENOTSUPPORTED:no\x1b\\", {}),
        ("]4;200;rgb:ffff/0000/d7d7\x1b\\", {"colours": 256}),
        ("P1$r0;48;5;16m\x1b\\", {}),
        ("P0$r\x1b\\", {}),
        ("P1$r48;2;1;2;3m\x1b\\", {"colours": TRUE_COLOUR}),
        ("[6;0;0t", {}),
        ("]11;rgb:ffff/ffff/ffff\x07", {"light": True}),
        ("]11;rgb:ff/fd/d0\x1b\\", {"light": True}),
        ("]11;rgba:0000/0000/0000/ffff\x1b\\", {"light": False}),
        ("]11;rgb:1c1c/1c1c/ffff\x07", {"light": False}),
        ("]10;rgb:ffff/ffff/ffff\x07", {}),
        ("]11;rgb:ffff/ffff/ffff", {}),
    ],
)
def test_each_answer_tells_one_fact(answer: str, changed: dict[str, object]) -> None:
    assert told(answer) == TerminalFacts(**{"colours": 16, **changed})  # type: ignore[arg-type]


def test_kitty_graphics_count_more_than_sixels() -> None:
    assert told("_Gi=31;OK\x1b\\", "[?62;4c").pixels == "kitty"


@pytest.mark.parametrize(
    ("kind", "colours", "asked"), [("0;136;0", TRUE_COLOUR, True), ("83;40900;0", 16, False), ("84;0;0", 16, True)]
)
def test_kind_says_what_may_be_asked(kind: str, colours: int, asked: bool) -> None:
    facts = UNKNOWN.of_kind(kind)
    assert (facts.colours, facts.can_be_asked_more) == (colours, asked)


@pytest.mark.parametrize("answer", [*XTERM, *KITTY])
def test_each_beginning_may_become_answer(answer: str) -> None:
    assert is_answer(answer)
    assert all(may_become_answer(answer[:length]) for length in range(1, len(answer)))


@pytest.mark.parametrize("size", [1, 3, 1000])
def test_answers_among_keys_lose_none(size: int) -> None:
    typed = "a" + "".join(f"\x1b{answer}\x1b[A" for answer in (*XTERM, *KITTY)) + "\x1b[6~\x1b[?"
    parser = KeyParser()
    read = [
        event
        for at in range(0, len(typed), size)
        for event in parser.feed(typed[at : at + size])
        if isinstance(event, Key)
    ]
    answers = [event.character for event in read if event.key == "<terminal-fact>"]
    keys = [event.key for event in read if event.key != "<terminal-fact>"]
    assert answers == [*XTERM, *KITTY]
    assert keys == ["a", *["up"] * len(answers), "pagedown"]
