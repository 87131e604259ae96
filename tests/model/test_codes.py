"""Every event code is documented, and only those."""

from __future__ import annotations

import re
from pathlib import Path

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Event, Level

_TABLE = Path(__file__).parents[2] / "docs" / "events.md"


def test_the_document_lists_every_code_in_order() -> None:
    cells = re.findall(r"^\| (`[^|]+`) \|", _TABLE.read_text(), re.MULTILINE)
    assert [code for cell in cells for code in re.findall(r"`([^`]+)`", cell)] == list(EventCode)


def test_an_events_source_is_its_codes_first_part() -> None:
    assert {Event(1, 0.0, Level.INFO, code, "").source for code in EventCode} == {
        "engine",
        "operator",
        "attach",
        "log",
        "key",
        "link",
        "route",
    }
