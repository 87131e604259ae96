"""Ages on a terminal that is late: as old as what is shown will be once the operator sees it."""

from tests.console.driving import engine_of, on_main, put, shown, text
from tests.console.scripted import ROUTES
from textual.pilot import Pilot

from rsb_console.app import ConsoleApp


@on_main()
async def test_lateness_counts_in_ages(app: ConsoleApp, pilot: Pilot[None]) -> None:
    app.writer.late = 2.0  # type: ignore[misc]
    put(app, ROUTES[2])  # whose last message came 2.1 s ago
    await shown(pilot, "last message 4.1s ago")
    assert "2.1s" not in text(app)
    assert app.as_seen(1.0) == 3.0


@on_main()
async def test_lateness_that_no_age_shows_changes_nothing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    assert app.snapshot() is engine_of(app).snapshot()
    app.writer.late = 0.09  # type: ignore[misc]
    assert app.snapshot() is engine_of(app).snapshot()
    assert app.as_seen(1.0) == 1.0
