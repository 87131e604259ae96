"""Settings of ``console.yaml`` that features add."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rsb_bridge.installed_features import added

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import msgspec

T = TypeVar("T")
SETTINGS_OF_CORE = ("bell", "columns", "notify", "refresh_rate", "terminal", "theme")


@dataclass(frozen=True)
class ConsoleSetting(Generic[T]):
    """A setting that the user writes into ``console.yaml``.

    Attributes:
        default: without the setting.
        read: makes the value of what YAML gave, or raises ValueError with a reason that begins with the place of the
            mistake: ``commands.x.run: give a text``.
    """

    name: str
    default: T
    read: Callable[[object], T]

    def of(self, preferences: Any) -> T:
        """Return the setting's value in the `rsb_console.preferences.Preferences`."""
        value: T = preferences.features.get(self.name, self.default)
        return value


def placed(name: str, error: msgspec.ValidationError) -> str:
    """Return msgspec's text about a part of a setting, with the setting's name before the part's place."""
    found = re.fullmatch(r"(.*?)(?: - at `\$(.*)`)?", str(error), re.DOTALL)
    assert found is not None
    return f"{name}{found[2] or ''}: {found[1]}"


@cache
def feature_settings() -> Mapping[str, ConsoleSetting[Any]]:
    """Return the features' settings by name."""
    found = added("console_settings", name_of=lambda setting: setting.name, taken=SETTINGS_OF_CORE)
    return {setting.name: setting for setting in found}
