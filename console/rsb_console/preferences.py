"""The user's themes, keys and settings. The console reports mistakes in them and uses its defaults instead."""

from __future__ import annotations

from typing import TYPE_CHECKING

import yaml

from rsb_bridge.model.wording import Wording
from rsb_console.actions import ACTIONS, BY_ID, FLEET_ACTIONS
from rsb_console.look.themes import default_theme, load_themes, shipped_path

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from rsb_console.actions import Action

KEY_SIGNS = {
    "slash": "/", "question_mark": "?", "escape": "esc", "less_than_sign": "<", "greater_than_sign": ">", "plus": "+",
    "minus": "-", "exclamation_mark": "!", "colon": ":", "pagedown": "PgDn", "pageup": "PgUp",
}  # fmt: skip
UNICODE_KEY_SIGNS = {"enter": "⏎", "up": "↑", "down": "↓"}


class PreferenceProblem(Wording):
    """Mistakes in the user's settings."""

    NO_KEYMAP = "{path}: must map action ids to keys, like 'pause: P'"
    UNKNOWN_ACTIONS = "{path}: no action is named {actions}; the help (?) lists them"
    SHARED_KEY = "{path}: {key!r} is the key of both {one} and {other}; change one of them"
    UNKNOWN_THEME = "no theme is named {theme!r}; choose one of {themes}"


class KeymapError(ValueError):
    """A mistake in ``keys.yaml`` or ``console.yaml``; the message is for the user."""


def load_keymap(path: Path) -> dict[str, str]:
    """Read the user's keys.

    Args:
        path: a YAML mapping of action ids to Textual key names; may be missing.

    Returns:
        Action ids to comma-separated keys.

    Raises:
        KeymapError: it cannot be read, names no action of ours, or gives one key to two actions.
    """
    loaded = _read(path)
    if not isinstance(loaded, dict):
        raise KeymapError(PreferenceProblem.NO_KEYMAP(path=path))
    # YAML reads the key 5 as a number.
    keymap = {str(action): str(keys) for action, keys in loaded.items()}
    unknown = sorted(set(keymap) - set(BY_ID))
    if unknown:
        raise KeymapError(PreferenceProblem.UNKNOWN_ACTIONS(path=path, actions=", ".join(unknown)))
    _refuse_shared_keys(path, keymap)
    return keymap


def _read(path: Path) -> object:
    """Return a file's content, or an empty mapping if it is missing or empty."""
    try:
        loaded = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise KeymapError(f"{path}: {error}") from None
    return {} if loaded is None else loaded


def _refuse_shared_keys(path: Path, keymap: Mapping[str, str]) -> None:
    # Each by itself: the two screens are never in one app, and share keys such as space.
    for actions in (ACTIONS, FLEET_ACTIONS):
        owner: dict[str, str] = {}
        for action in actions:
            for key in split_keys(keymap.get(action.id, action.keys)):
                if key in owner:
                    shared = PreferenceProblem.SHARED_KEY(path=path, key=key, one=owner[key], other=action.id)
                    raise KeymapError(shared)
                owner[key] = action.id


def split_keys(keys: str) -> Iterable[str]:
    """Return the keys of a comma-separated list."""
    return (key.strip() for key in keys.split(",") if key.strip())


class Preferences:
    """The themes and keys to use.

    Args:
        config: the user's folder, perhaps with ``themes/``, ``keys.yaml`` and ``console.yaml``.
        theme: the name of a theme, or None for one that suits the terminal.

    Attributes:
        theme: the name of the one to begin with.
        keymap: action ids to the user's keys.
        bell: whether the terminal's bell for new faults is on at the start.
        problems: titles and texts of mistakes.
    """

    def __init__(self, config: Path, theme: str | None) -> None:
        self.problems: list[tuple[str, str]] = []
        self.keymap: dict[str, str] = {}
        self.theme = self._load_themes(config, theme)
        self._load_keys(config)
        self.bell = False
        self._load_settings(config / "console.yaml")

    def _load_themes(self, config: Path, wanted: str | None) -> str:
        self.themes, problems = load_themes(shipped_path(), config / "themes")
        if wanted is not None and wanted not in self.themes:
            problems.append(PreferenceProblem.UNKNOWN_THEME(theme=wanted, themes=", ".join(self.themes)))
            wanted = None
        if problems:
            self.problems.append(("Themes skipped", "\n".join(problems)))
        return wanted or default_theme()

    def _load_keys(self, config: Path) -> None:
        try:
            self.keymap = load_keymap(config / "keys.yaml")
        except KeymapError as error:
            self.problems.append(("The default keys are used", str(error)))

    def _load_settings(self, path: Path) -> None:
        try:
            settings = _read(path)
        except KeymapError as error:
            self.problems.append(("The default settings are used", str(error)))
            return
        if (
            not isinstance(settings, dict)
            or set(settings) - {"bell"}
            or not isinstance(settings.get("bell", False), bool)
        ):
            self.problems.append(("The default settings are used", f"{path}: give bell: true, or bell: false"))
            return
        self.bell = settings.get("bell", False)

    def keys(self, action: Action) -> list[str]:
        """Return the keys that do `action`, by Textual's names."""
        return list(split_keys(self.keymap.get(action.id, action.keys)))

    def key_labels(self, action: Action, *, ascii_only: bool) -> list[str]:
        """Return the keys that do `action`, as they are written on a keyboard."""
        signs = KEY_SIGNS if ascii_only else KEY_SIGNS | UNICODE_KEY_SIGNS
        return [signs.get(key, key.replace("ctrl+", "^")) for key in self.keys(action)]
