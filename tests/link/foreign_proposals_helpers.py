"""Helpers of `test_foreign_proposals` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.inside import inside
from tests.support.rogue import Rogue

from rsb_bridge.config.keys import read_key

if TYPE_CHECKING:
    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine
    from rsb_bridge.link.link import Link


def rogue(bridge: Bridge, *features: str) -> Rogue:
    """Return a client that claims to have some features."""
    return Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret, features=features)


def link(engine: Engine) -> Link:
    return inside(engine).role.links()[0]
