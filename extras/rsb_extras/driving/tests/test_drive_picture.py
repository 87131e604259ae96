"""The picture of driving in the documentation."""

import re
from html import unescape
from pathlib import Path

from rsb_extras.driving.drive_screen import DriveText

PICTURE = Path(__file__).parents[1] / "docs/pictures/drive.svg"


def test_it_shows_a_key_and_its_motion() -> None:
    words = unescape(PICTURE.read_text(encoding="utf-8")).replace("\xa0", " ")
    assert re.search(r"forward \+0\.\d\d m/s", words), "make screenshots"
    assert "moving" in words
    assert "turning" in words
    assert DriveText.NO_KEY() not in words
