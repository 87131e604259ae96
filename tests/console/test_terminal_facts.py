"""What terminals tell of themselves, as xterm 379, kitty 0.26, urxvt 9.30, PuTTY 0.78, tmux 3.3 and screen 4.9 do."""

from __future__ import annotations

import os
import pty
import re
import threading
from functools import reduce
from pathlib import Path

import pyte
import pytest
from textual.events import Key

from rsb_console.terminal.driver import KeyParser
from rsb_console.terminal.terminal_facts import (
    QUESTIONS,
    TRUE_COLOUR,
    TerminalFacts,
    TerminalSettings,
    ask,
    facts_before_answers,
    is_answer,
    may_become_answer,
)

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


def test_questions_leave_the_look_of_the_last_frame() -> None:
    """The next frame says only what differs: after a reset, cells of the same paper were black."""
    screen = pyte.Screen(9, 1)
    stream = pyte.Stream(screen)
    stream.feed("\x1b[1;38;2;1;1;1;48;2;18;18;18ma")
    stream.feed(re.sub("\x1b[P_][^\x1b]*\x1b\\\\|\x1b\\]4[^\x07]*\x07|\x1b\\[>q", "", QUESTIONS))  # pyte shows these
    stream.feed("b")
    assert screen.display == ["ab       "]
    assert screen.buffer[0][1] == screen.buffer[0][0]._replace(data="b")


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


# -- a command asks


def asked(kind: str, answers: tuple[str, ...], term: str = "xterm-256color") -> tuple[TerminalFacts, bytes]:
    """Return the facts of a terminal that answers so, and what it was asked."""
    master, slave = pty.openpty()
    seen = b""

    def answer() -> None:
        nonlocal seen
        for ends, reply in ((1, f"typed{kind}\x1b[?62;c"), (2, "".join(f"\x1b{each}" for each in answers))):
            while seen.count(b"\x1b[c") < ends:
                try:
                    seen += os.read(master, 1000)
                except OSError:
                    return
            os.write(master, reply.encode())

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        return ask(UNKNOWN, {"TERM": term}, slave, slave), seen
    finally:
        os.close(slave)
        thread.join()
        os.close(master)


def test_command_asks_and_takes_all_answers() -> None:
    facts, _ = asked("\x1b[>41;379;0c", XTERM)
    assert (facts.name, facts.colours, facts.cell, facts.kind) == ("XTerm(379)", TRUE_COLOUR, (8, 19), "41;379;0")


def test_screen_is_not_asked_what_it_would_print() -> None:
    facts, seen = asked("\x1b[>83;40900;0c", XTERM)
    assert facts.colours == 16
    assert b"\x1bP" not in seen
    assert b"\x1b_" not in seen


def test_terminal_that_would_print_questions_is_not_asked() -> None:
    assert asked("\x1b[>41;379;0c", XTERM, "vt220") == (UNKNOWN, b"")


# -- what the environment and the user say


@pytest.mark.parametrize(
    ("environ", "colours", "erases"),
    [
        ({"TERM": "xterm"}, 16, True),
        ({"TERM": "xterm-256color"}, 256, True),
        ({"TERM": "xterm", "COLORTERM": "truecolor"}, TRUE_COLOUR, True),
        ({"TERM": "dumb", "COLORTERM": "truecolor"}, 0, False),
        ({"TERM": "alacritty"}, 256, True),
        ({"TERM": "screen-256color"}, 256, False),
        ({"TERM": "vt220"}, 16, False),
        ({}, 0, False),
    ],
)
def test_environment_is_what_is_known_first(environ: dict[str, str], colours: int, erases: bool) -> None:
    with Path(os.devnull).open() as no_terminal:
        facts = facts_before_answers(environ, no_terminal.fileno())
    assert facts == TerminalFacts(colours=colours, erases=erases)
    assert not facts.of_kind("83;40900;0").erases, "GNU screen, whatever TERM says"


def test_user_knows_better_than_terminal() -> None:
    settings = TerminalSettings.read({"colours": True, "pixels": "none", "cell": "9x21"})
    assert settings.over(told(*KITTY)) == TerminalFacts(
        "kitty(0.26.5)", "", TRUE_COLOUR, (9, 21), "", None, answered=True
    )
    assert TerminalSettings.read({}).over(UNKNOWN) == UNKNOWN


@pytest.mark.parametrize(
    ("given", "place"),
    [
        (3, "terminal:"),
        ({"colours": 17}, "terminal.colours:"),
        ({"cell": "0x9"}, "terminal.cell:"),
        ({"x": 1}, "terminal:"),
    ],
)
def test_mistake_in_terminal_names_its_place(given: object, place: str) -> None:
    with pytest.raises(ValueError, match="terminal") as refusal:
        TerminalSettings.read(given)
    assert str(refusal.value).startswith(place)
