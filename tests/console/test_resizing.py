"""A terminal that changes its size while the console starts: the console goes on, at the size that the terminal has."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.console.driving import on_main, until
from tests.support import replaced
from textual.events import Resize
from textual.geometry import Size

from rsb_console.library_internals.textual_internals import is_idle

if TYPE_CHECKING:
    import pytest
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp

OLD, NOW = Size(80, 24), Size(120, 36)


def test_sizes_in_flight_do_not_alternate_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[Size] = []
    take = replaced.TEXTUAL_ON_RESIZE.value

    async def counted(screen: Any, event: Resize) -> None:
        taken.append(event.size)
        await take(screen, event)

    @on_main((NOW.width, NOW.height))
    async def test(app: ConsoleApp, pilot: Pilot[None]) -> None:
        replaced.TEXTUAL_ON_RESIZE.set(monkeypatch, counted)
        for size in (OLD, NOW):
            app.screen.post_message(Resize(size, size))
            app.screen.call_later(lambda: None)  # else the second one replaces the first
        await until(pilot, lambda: len(taken) > 9 or (NOW in taken and is_idle(app.screen)), "the size")
        assert set(taken) == {NOW}
        assert app.screen.size == NOW

    test()
