"""The line on mirrored nodes, on the page of a link and in ``status``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import plural
from rsb_console.feature_console import LinkFact
from rsb_extras.mirrored_nodes import MIRRORED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.feature_api import LinkSnapshot


def _count(link: LinkSnapshot) -> Sequence[str]:
    mirrored = MIRRORED.of(link)
    return () if mirrored is None else (f"{mirrored.nodes} {plural(mirrored.nodes, 'node')} of it here",)


def _left_out(link: LinkSnapshot) -> Sequence[str]:
    mirrored = MIRRORED.of(link)
    return () if mirrored is None else mirrored.left_out


FACT = LinkFact("mirrored", _count, _left_out)
