"""The heights that a widget is drawn in, one after the other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from textual.screen import Screen

if TYPE_CHECKING:
    import pytest


def heights_of(selector: str, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list of the heights that a widget on the top screen is drawn in from now on, each once in a row."""
    heights: list[int] = []
    usual = Screen._compositor_refresh

    def refresh(screen: Screen[Any]) -> None:
        usual(screen)
        found = [each.outer_size.height for each in screen.query(selector)] if screen.is_current else []
        if any(found) and heights[-1:] != found:
            heights.extend(found)

    monkeypatch.setattr(Screen, "_compositor_refresh", refresh)
    return heights
