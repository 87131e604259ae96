"""Helpers of `test_outlive` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.inside import inside

if TYPE_CHECKING:
    from rsb_bridge.engine import Engine


OUTLIVES = 60.0


def away(engine: Engine) -> bool:
    (link,) = inside(engine).role.links()
    return link.suspended_since is not None


def numbers(payloads: list[bytes]) -> list[int]:
    return [int(each[8:].split(b" ")[0].rstrip(b"\0")) for each in payloads]
