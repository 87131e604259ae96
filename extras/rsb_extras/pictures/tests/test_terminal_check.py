"""What doctor says of a terminal."""

from __future__ import annotations

import pytest
from tests.support import surroundings
from tests.support.wording import says

from rsb_bridge.model.finding import Grade
from rsb_console.terminal.terminal_facts import TRUE_COLOUR, TerminalFacts
from rsb_extras.pictures.terminal_check import TerminalText, finding, terminal

KITTY = TerminalFacts("kitty(0.26.5)", "1;4000;26", TRUE_COLOUR, (9, 18), "kitty")


@pytest.mark.parametrize(
    ("facts", "text", "remedy"),
    [
        (KITTY, TerminalText.PIXELS, ""),
        (TerminalFacts(colours=16), TerminalText.BLOCKS, TerminalText.MORE_COLOURS()),
        (TerminalFacts("XTerm(379)", "", TRUE_COLOUR), TerminalText.BLOCKS, TerminalText.MORE_PIXELS()),
    ],
)
def test_finding_says_what_is_shown_and_how_to_get_more(facts: TerminalFacts, text: TerminalText, remedy: str) -> None:
    found = finding(facts)
    assert says(found.text, text, facts=facts.line())
    assert (found.remedy, found.grade) == (remedy, Grade.NOTE if remedy else Grade.OK)


def test_ascii_shows_no_pixels() -> None:
    found = finding(KITTY, ascii_only=True)
    assert says(found.text, TerminalText.ASCII)
    assert (found.remedy, found.grade) == (TerminalText.MORE_CHARACTERS(), Grade.NOTE)


def test_missing_library_is_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    surroundings.hide_modules(monkeypatch, "PIL")
    assert "rsb-console[look]" in finding(KITTY).remedy


def test_without_terminal_nothing_is_asked() -> None:
    (found,) = terminal()
    assert says(found.text, TerminalText.NONE)
