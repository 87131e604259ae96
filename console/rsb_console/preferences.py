"""The user's themes, keys and settings. The console reports mistakes in them and uses its defaults instead."""

from __future__ import annotations

from typing import TYPE_CHECKING

import yaml

from rsb_console.actions.keymap import KeymapError, load_keymap, split_keys
from rsb_console.look.themes import default_theme, load_themes, shipped_path

if TYPE_CHECKING:
    from pathlib import Path

    from textual.theme import Theme

    from rsb_console.actions.registry import Action

KEY_SIGNS = {
    "slash": "/", "question_mark": "?", "escape": "esc", "less_than_sign": "<", "greater_than_sign": ">", "plus": "+",
    "minus": "-", "exclamation_mark": "!", "colon": ":", "pagedown": "PgDn", "pageup": "PgUp",
}  # fmt: skip
UNICODE_KEY_SIGNS = {"enter": "⏎", "up": "↑", "down": "↓"}


class Preferences:
    """The themes and keys to use.

    Args:
        config: the user's folder, perhaps with ``themes/``, ``keys.yaml`` and ``console.yaml``.
        theme: the name of a theme, or None for one that suits the terminal.

    Attributes:
        themes: by name.
        theme: the name of the one to begin with.
        keymap: action ids to the user's keys.
        bell: whether the terminal's bell for new faults is on at the start.
        problems: titles and texts of mistakes.
    """

    def __init__(self, config: Path, theme: str | None) -> None:
        self.problems: list[tuple[str, str]] = []
        self.themes: dict[str, Theme] = {}
        self.keymap: dict[str, str] = {}
        self.theme = self._load_themes(config, theme)
        self._load_keys(config)
        self.bell = False
        self._load_settings(config / "console.yaml")

    def _load_themes(self, config: Path, wanted: str | None) -> str:
        loaded = load_themes(shipped_path(), config / "themes")
        self.themes = loaded.found
        problems = list(loaded.problems)
        if wanted is not None and wanted not in self.themes:
            problems.append(f"no theme is called {wanted!r}; there are {', '.join(self.themes)}")
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
            loaded = yaml.safe_load(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            self.problems.append(("The default settings are used", f"{path}: {error}"))
            return
        settings = {} if loaded is None else loaded
        if (
            not isinstance(settings, dict)
            or set(settings) - {"bell"}
            or not isinstance(settings.get("bell", False), bool)
        ):
            self.problems.append(("The default settings are used", f"{path}: give bell: true, or bell: false"))
            return
        self.bell = settings.get("bell", False)

    def keys(self, action: Action) -> list[str]:
        """The keys that do `action`, by Textual's names."""
        return list(split_keys(self.keymap.get(action.id, action.keys)))

    def key_labels(self, action: Action, *, ascii_only: bool) -> list[str]:
        """The keys that do `action`, as they are written on a keyboard."""
        signs = KEY_SIGNS if ascii_only else KEY_SIGNS | UNICODE_KEY_SIGNS
        return [signs.get(key, key.replace("ctrl+", "^")) for key in self.keys(action)]
