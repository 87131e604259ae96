"""Exact pictures of the screen that shows messages as pictures."""

import pytest
from tests.console.driving import NARROW, scripted_app
from tests.console.pictures_helpers import SnapCompare, after

from rsb_extras.pictures.tests.pictures_on_screen_helpers import LOOKED_AT, LookedAtEngine


@pytest.mark.parametrize("shows", LOOKED_AT)
def test_view(snap_compare: SnapCompare, shows: str) -> None:
    engine = type("Engine", (LookedAtEngine,), {"shows": shows})
    run_before = after(LOOKED_AT[shows][2][0], "v")
    assert snap_compare(scripted_app(make_engine=engine), terminal_size=NARROW, run_before=run_before)
