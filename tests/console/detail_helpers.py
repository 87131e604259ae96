"""Helpers of `test_detail` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.console.scripted import NOW

from rsb_console.widgets.detail import detail_lines

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot


def said(about: RouteSnapshot, width: int = 60) -> str:
    return "\n".join("".join(piece for piece, _ in line) for line in detail_lines(about, "10.0.0.20:49152", width, NOW))
