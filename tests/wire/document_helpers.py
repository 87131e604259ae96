"""Helpers of `test_document` and others."""

from __future__ import annotations

import re


def documented_fields(text: str) -> dict[str, set[str]]:
    """Tables of messages: the first column names a message where it isn't empty, the second its fields."""
    fields: dict[str, set[str]] = {}
    name = ""
    for row in re.findall(r"^\|(.*)\|$", text, re.MULTILINE):
        first, second, *_ = (cell.strip() for cell in row.split("|"))
        if first in ("message", "map") or first.startswith("---"):
            continue
        name = first or name
        fields.setdefault(name, set()).update(re.split(", *", second))
    return fields
