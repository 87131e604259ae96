"""Every code of the exporters' events is documented, and only those."""

from __future__ import annotations

import re
from pathlib import Path

from rsb_extras.exporters.exporter_codes import ExporterCode

_PAGE = Path(__file__).parents[1] / "docs" / "exporters.md"


def test_the_page_lists_every_code_in_order() -> None:
    table = _PAGE.read_text(encoding="utf-8").partition("## Events\n")[2].partition("\n## ")[0]
    cells = re.findall(r"^\| (`[^|]+`) \|", table, re.MULTILINE)
    assert [code for cell in cells for code in re.findall(r"`([^`]+)`", cell)] == list(ExporterCode)
