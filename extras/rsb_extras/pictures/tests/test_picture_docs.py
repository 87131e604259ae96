"""Events and control messages of pictures are documented, and only those."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
import pytest

from rsb_extras.pictures import FEATURE
from rsb_extras.pictures.link_views import ViewCode
from rsb_extras.pictures.picture import Wish

_DOCS = Path(__file__).parents[1] / "docs"
_ROOT = _DOCS.parents[3]
_PROTOCOL = (_DOCS / "picture-protocol.md").read_text(encoding="utf-8")


def test_the_page_lists_every_code_in_order() -> None:
    table = (_DOCS / "views.md").read_text(encoding="utf-8").partition("## Events\n")[2].partition("\n## ")[0]
    cells = re.findall(r"^\| (`[^|]+`) \|", table, re.MULTILINE)
    assert [code for cell in cells for code in re.findall(r"`([^`]+)`", cell)] == list(ViewCode)


def test_exactly_the_fields_sent_are_documented() -> None:
    documented: dict[str, list[str]] = {}
    name = ""
    table = _PROTOCOL.partition("| message | field |")[2].partition("\n\n")[0]
    for row in re.findall(r"^\|(.*)\|$", table, re.MULTILINE):
        first, second, *_ = (cell.strip() for cell in row.split("|"))
        name = first or name
        documented.setdefault(name, []).append(second)
    documented.pop("---", None)
    assert documented == {
        message.__name__: [field.name for field in msgspec.structs.fields(message)] for message in FEATURE.messages()
    }
    wish = re.findall(r"^\| ([\w, ]+) \|", _PROTOCOL.partition("\n| field |")[2].partition("\n|---")[2], re.MULTILINE)
    assert {each for cell in wish for each in cell.split(", ")} == {
        field.name for field in msgspec.structs.fields(Wish)
    }


@pytest.mark.parametrize(
    "picture", sorted(_ROOT.glob("extras/rsb_extras/*/docs/pictures/*.svg")), ids=lambda each: each.stem
)
def test_a_picture_of_a_camera_is_in_colour(picture: Path) -> None:
    """A terminal of 16 colours would draw it in four greys."""
    text = picture.read_text(encoding="utf-8")
    assert "rgb8" not in text or len(set(re.findall(r"#[0-9a-f]{6}", text))) > 100, "make screenshots"
