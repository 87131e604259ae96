"""Things to look at on a screen of their own, which features add behind topics and tiles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rsb_bridge.installed_features import added

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from textual.app import App

    from rsb_console.console_api import Console


@dataclass(frozen=True, slots=True)
class LookOption:
    """One row of the list of what can be looked at.

    Attributes:
        name: in the list, where it is found by this.
        about: text behind the name. Both together tell it from others.
        show: shows it, or notifies the operator of the reason why it cannot be shown.
    """

    name: str
    about: str
    show: Callable[[Console, App[Any]], Awaitable[None]]


def look_options() -> tuple[LookOption, ...]:
    """Return all that features add now."""
    return added("look_options")
