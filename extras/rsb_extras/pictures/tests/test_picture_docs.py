"""Events and control messages of pictures are documented, and only those."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec

from rsb_extras.pictures import FEATURE
from rsb_extras.pictures.link_views import ViewCode
from rsb_extras.pictures.picture import Wish

_DOCS = Path(__file__).parents[1] / "docs"
_PROTOCOL = (_DOCS / "picture-protocol.md").read_text(encoding="utf-8")


def test_the_page_lists_every_code_in_order() -> None:
    table = (_DOCS / "views.md").read_text(encoding="utf-8").partition("## Events\n")[2].partition("\n## ")[0]
    cells = re.findall(r"^\| (`[^|]+`) \|", table, re.MULTILINE)
    assert [code for cell in cells for code in re.findall(r"`([^`]+)`", cell)] == list(ViewCode)


def test_every_field_on_the_wire_is_documented_and_no_other() -> None:
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
