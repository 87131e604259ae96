"""Pictures on terminals without Unicode: readable ASCII, and no question mark but those of the data."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from tests.console.driving import NARROW, drive, scripted_app, shown, text, until
from tests.support.filled import filled

from rsb_console.notation.ascii_signs import to_ascii
from rsb_extras.pictures.blocks import RAMP
from rsb_extras.pictures.drawing import VIEWS
from rsb_extras.pictures.picture import Cells, Series, Wish
from rsb_extras.pictures.picture_rows import picture_rows
from rsb_extras.pictures.tests.hostile_helpers import INSTALLED, draw, kind
from rsb_extras.pictures.tests.map_view_helpers import grid
from rsb_extras.pictures.tests.pictures_on_screen_helpers import LOOKED_AT, LookedAtEngine
from rsb_extras.pictures.tests.samples import task

if TYPE_CHECKING:
    from textual.pilot import Pilot

WAYS = sorted({"", *(how for how in VIEWS if "/" not in how)})


def lost(shown_text: str) -> set[str]:
    """Return the characters of a text that become question marks, which are none themselves."""
    return {char for char in shown_text if char != "?" and "?" in to_ascii(char)}


@pytest.mark.parametrize("type_name", INSTALLED)
def test_every_view_has_ascii(type_name: str) -> None:
    message = grid(7) if type_name == "nav_msgs/msg/OccupancyGrid" else filled(kind(type_name))
    for how in WAYS:
        wish = Wish(width=60, height=20, how=how)
        picture = draw(task(wish, message))
        assert not lost("".join((*picture.notes, picture.problem)))
        if isinstance(content := picture.content, Cells | Series):
            for colours in (0, 16):
                rows = picture_rows(content, wish.width, wish.height, colours=colours)
                assert not lost("".join(part.text for row in rows for part in row))


@pytest.mark.parametrize("colours", [0, 16, 256, 1 << 24])
@pytest.mark.parametrize("shows", LOOKED_AT)
def test_tile_is_readable_in_ascii(shows: str, colours: int) -> None:
    engine = type("Engine", (LookedAtEngine,), {"shows": shows})
    app = scripted_app(make_engine=engine, ascii_only=True)
    app.facts = replace(app.facts, colours=colours)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        await pilot.press("v")
        await shown(pilot, to_ascii(LOOKED_AT[shows][2][0]))
        if shows == "image":
            await until(pilot, lambda: sum(map(text(app).count, RAMP.strip())) > 500, "the brightness of an image")
        assert "?" not in text(app)
        assert text(app).isascii()

    drive(app, steps, NARROW)
