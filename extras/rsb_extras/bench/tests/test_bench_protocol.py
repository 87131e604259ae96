"""The page on the protocol against the code."""

from __future__ import annotations

from pathlib import Path

import msgspec
from tests.wire.document_helpers import documented_fields

from rsb_extras import bench

PAGE = Path(bench.__file__).with_name("docs") / "bench-protocol.md"


def test_every_field_is_documented_and_no_other() -> None:
    found = {each.__name__: {field.name for field in msgspec.structs.fields(each)} for each in bench.FEATURE.messages()}
    assert documented_fields(PAGE.read_text(encoding="utf-8")) == found
