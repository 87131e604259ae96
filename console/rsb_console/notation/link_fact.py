"""Lines on links that features add."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from rsb_bridge.installed_features import added

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.model.snapshot import LinkSnapshot


@dataclass(frozen=True, slots=True)
class LinkFact:
    """A fact without a column, on the page of a link.

    Attributes:
        label: its name, at most 12 cells.
        lines: formats it; no line leaves it out.
        wrong: gives what is wrong about it, with the remedy. ``status`` prints that, too.
    """

    label: str
    lines: Callable[[LinkSnapshot], Sequence[str]]
    wrong: Callable[[LinkSnapshot], Sequence[str]] = lambda _: ()


OF_CORE: Final = ("why", "known", "peer", "way", "key", "next key", "its clock", "packets lost")
"""The core's own names."""
ADDED_FACTS: Final[tuple[LinkFact, ...]] = added("link_facts", name_of=lambda fact: fact.label, taken=OF_CORE)


def wrong_of(link: LinkSnapshot) -> list[str]:
    """Return what is wrong about a link by the facts of features."""
    return [text for fact in ADDED_FACTS for text in fact.wrong(link)]
