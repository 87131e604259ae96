"""The user's own keys: ``keys.yaml`` maps action ids to keys.

For example::

    pause: P
    move_down: j,down,ctrl+n
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import yaml

from rsb_console.actions.registry import ACTIONS, BY_ID, FLEET_ACTIONS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path


class KeymapError(ValueError):
    """A mistake in ``keys.yaml``; the message says which, for the user."""


def load_keymap(path: Path) -> dict[str, str]:
    """Read the user's keys.

    Args:
        path: a YAML mapping of action ids to Textual key names; need not exist.

    Returns:
        Action ids to comma-separated keys.

    Raises:
        KeymapError: it cannot be read, names no action of ours, or gives one key to two actions.
    """
    try:
        loaded = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise KeymapError(f"{path}: {error}") from None
    if loaded is None:
        return {}
    if not isinstance(loaded, dict):
        raise KeymapError(f"{path}: must map action ids to keys, like 'pause: P'")
    keymap = {str(action): str(keys) for action, keys in loaded.items()}
    unknown = sorted(set(keymap) - set(BY_ID))
    if unknown:
        raise KeymapError(f"{path}: no action is called {', '.join(unknown)}; the help (?) lists them")
    _refuse_shared_keys(path, keymap)
    return keymap


def _refuse_shared_keys(path: Path, keymap: Mapping[str, str]) -> None:
    for actions in (ACTIONS, FLEET_ACTIONS):
        owner: dict[str, str] = {}
        for action in actions:
            for key in split_keys(keymap.get(action.id, action.keys)):
                if key in owner:
                    raise KeymapError(f"{path}: {key!r} is for both {owner[key]} and {action.id}; give one another key")
                owner[key] = action.id


def split_keys(keys: str) -> Iterable[str]:
    """The keys of a comma-separated list."""
    return (key.strip() for key in keys.split(",") if key.strip())
