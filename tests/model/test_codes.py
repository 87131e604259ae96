"""Every event code is documented, and only those."""

from __future__ import annotations

import re
from pathlib import Path

from rsb_bridge.model.codes import EventCode

_TABLE = Path(__file__).parents[2] / "docs" / "events.md"


def test_the_document_lists_every_code_in_order() -> None:
    cells = re.findall(r"^\| (`[^|]+`) \|", _TABLE.read_text(), re.MULTILINE)
    assert [code for cell in cells for code in re.findall(r"`([^`]+)`", cell)] == list(EventCode)
