"""The user's themes, keys and settings. The console reports mistakes in them and uses its defaults instead.

A theme is a YAML file of its own, whose name is the theme's. It holds Textual's theme colours (``primary: "#5fafff"``,
...), ``dark: true`` or ``false``, ``ansi: true`` for the terminal's own sixteen colours (``ansi_green``), and
``variables`` for single CSS variables.
"""

from __future__ import annotations

import math
import os
import re
import sysconfig
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import yaml
from platformdirs import user_config_path
from textual.color import Color, ColorParseError
from textual.theme import Theme

from rsb_bridge.config.files import change_by_others, is_there, make_folder, replace_file, why_not_written
from rsb_bridge.feature import BRINGS_ACTIONS, BRINGS_SETTINGS
from rsb_bridge.installed_features import added
from rsb_bridge.model.text import join_first
from rsb_bridge.model.wording import Wording
from rsb_console.actions.all_actions import ACTIONS, screens
from rsb_console.notation.console_setting import SETTINGS_OF_CORE, feature_settings
from rsb_console.notation.topic_column import ADDED, SHOWN_BY_CORE
from rsb_console.terminal.terminal_facts import TerminalSettings

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from rsb_console.actions.action import Action

THEME_COLORS = (
    "primary", "secondary", "warning", "error", "success", "accent", "foreground", "background", "surface", "panel",
    "boost",
)  # fmt: skip
_THEME_SWITCHES = ("dark", "ansi")
DEFAULT_THEME, LIGHT_THEME, SIXTEEN_COLORS, SIXTEEN_ON_LIGHT = "dark", "light", "terminal", "terminal-light"
THEME_VARIABLES = {
    "row-cursor": "#303030",
    "row-cursor-blurred": "#262626",
    "alarm": "#ffffff",
    "alarm-background": "#d70000",
    "quiet": "#808080",
    "rule": "#444444",
}
"""Defaults of the variables that our style sheet adds to Textual's."""
KEY_SIGNS = {
    "slash": "/", "question_mark": "?", "escape": "esc", "less_than_sign": "<", "greater_than_sign": ">", "plus": "+",
    "minus": "-", "exclamation_mark": "!", "colon": ":", "vertical_line": "|", "pagedown": "PgDn", "pageup": "PgUp",
}  # fmt: skip
UNICODE_KEY_SIGNS = {"enter": "⏎", "up": "↑", "down": "↓"}
Setting = str | float | bool | list[str] | dict[str, Any]
REFRESH_RATES = (0.5, 1.0, 2.0, 4.0, 10.0)  # Hz
TOPIC_COLUMNS = SHOWN_BY_CORE | {column.title: column.shows for column in ADDED}
"""Columns of the topics that an operator may leave out, and what they show; state and topic stay."""
_SETTING = r"^{name}\s*:[^#\n]*?(?P<comment>\s*#.*)?$"


class ThemeProblem(Wording):
    """Mistakes in a theme file."""

    NO_MAPPING = 'must map names to colours, like primary: "#5fafff"'
    UNKNOWN_KEYS = "{keys}: not part of a theme; it has {known}"
    KEY_MISSING = "{key} is missing"
    NO_SWITCH = "{key}: {value!r} is neither true nor false"
    NO_VARIABLES = "variables: must map names to values"
    NO_COLOR = '{key}: {value!r} is not a colour; give "#rrggbb" in quotes, or a name'


class PreferenceProblem(Wording):
    """Mistakes in the user's settings."""

    NO_KEYMAP = "{path}: must map action ids to keys, like 'pause: P'"
    UNKNOWN_ACTIONS = "{path}: no action is named {actions}; the help (?) lists them"
    OF_FEATURE = "{path}: this installation has no {feature}: install all of rsb-console, or leave {name} out"
    SHARED_KEY = "{path}: {key!r} is the key of both {one} and {other}; change one of them"
    NO_SETTINGS = "{path}: must map names to values, like 'bell: true'"
    UNKNOWN_SETTINGS = "{path}: {names}: no setting; there are {known}"
    NO_BELL = "{path}: bell: give true or false"
    NO_NOTIFY = "{path}: notify: give true or false"
    NO_RATE = "{path}: refresh_rate: give one of {rates}"
    NO_COLUMNS = "{path}: columns: give a list of {columns}"
    BY_FEATURE = "{path}: {mistake}"
    LAYOUT = "{path}: its layout cannot be changed here: write {line} into it"
    UNKNOWN_THEME = "no theme is named {theme!r}; choose one of {themes}"


class PreferenceError(ValueError):
    """A mistake in one of the user's files; the message is for the user."""


def config_path() -> Path:
    """Return the user's configuration folder, with ``keys.yaml`` and ``themes/``."""
    return user_config_path("rsb-console")


def shipped_themes() -> Path:
    """Return the folder of the shipped themes: next to the packages in a checkout, or in the installed shared data."""
    checkout = Path(__file__).parents[2]
    if (checkout / "pyproject.toml").is_file():
        return checkout / "themes"
    return Path(sysconfig.get_path("data")) / "share" / "rsb_console" / "themes"


def load_themes(*folders: Path) -> tuple[dict[str, Theme], list[str]]:
    """Read every ``*.yaml`` in `folders`; of two themes of the same name, the later one counts.

    Returns:
        The themes by name, and a line for each file that is no theme.
    """
    found: dict[str, Theme] = {}
    problems: list[str] = []
    for path in (path for folder in folders for path in sorted(folder.glob("*.yaml"))):
        try:
            found[path.stem] = _read_theme(path)
        except (PreferenceError, OSError, UnicodeDecodeError) as error:
            problems.append(f"{path}: {error}")
    return found, problems


def _read_theme(path: Path) -> Theme:
    try:
        loaded = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        # On one line, as all mistakes together are one toast.
        raise PreferenceError(" ".join(str(error).split())) from None
    if not isinstance(loaded, dict):
        raise PreferenceError(ThemeProblem.NO_MAPPING())
    unknown = sorted(str(key) for key in loaded if key not in {*THEME_COLORS, *_THEME_SWITCHES, "variables"})
    if unknown:
        raise PreferenceError(ThemeProblem.UNKNOWN_KEYS(keys=", ".join(unknown), known=", ".join(THEME_COLORS)))
    if "primary" not in loaded:
        raise PreferenceError(ThemeProblem.KEY_MISSING(key="primary"))
    for key in THEME_COLORS:
        if key in loaded:
            _check_color(key, loaded[key])
    for key in _THEME_SWITCHES:
        if not isinstance(loaded.get(key, True), bool):
            raise PreferenceError(ThemeProblem.NO_SWITCH(key=key, value=loaded[key]))
    variables = loaded.pop("variables", {})
    if not isinstance(variables, dict):
        raise PreferenceError(ThemeProblem.NO_VARIABLES())
    for key, value in variables.items():
        if key in THEME_VARIABLES:  # Textual's own may be no colours, such as a style
            _check_color(f"variables.{key}", value)
    return Theme(name=path.stem, variables={str(key): str(value) for key, value in variables.items()}, **loaded)


def _check_color(key: str, value: Any) -> None:
    try:
        Color.parse(value)
    except (ColorParseError, TypeError, AttributeError):  # no text: to YAML, #5fafff without quotes is a comment
        raise PreferenceError(ThemeProblem.NO_COLOR(key=key, value=value)) from None


def default_theme(environ: Mapping[str, str] = os.environ) -> str:
    """Return the name of the theme that suits this terminal: of sixteen colours if the terminal announces no more."""
    many = environ.get("COLORTERM") in {"truecolor", "24bit"} or "256color" in environ.get("TERM", "")
    return DEFAULT_THEME if many else SIXTEEN_COLORS


def load_keymap(path: Path) -> dict[str, str]:
    """Read the user's keys: a YAML mapping of action ids to comma-separated key names of Textual.

    Raises:
        PreferenceError: the file cannot be read, names no action of ours, or gives one key to two actions.
    """
    loaded = _read(path)
    if not isinstance(loaded, dict):
        raise PreferenceError(PreferenceProblem.NO_KEYMAP(path=path))
    # YAML reads the key 5 as a number.
    keymap = {str(action): str(keys) for action, keys in loaded.items()}
    unknown = sorted(set(keymap) - {action.id for actions in screens() for action in actions})
    if absent := next((action for action in unknown if action in BRINGS_ACTIONS), ""):
        feature = BRINGS_ACTIONS[absent]
        raise PreferenceError(PreferenceProblem.OF_FEATURE(path=path, feature=feature, name=absent))
    if unknown:
        raise PreferenceError(PreferenceProblem.UNKNOWN_ACTIONS(path=path, actions=", ".join(unknown)))
    # Each by itself: two screens are never in one app, and share keys such as space.
    for actions in screens():
        owner: dict[str, str] = {}
        for action in actions:
            for key in split_keys(keymap.get(action.id, action.keys)):
                if key in owner:
                    shared = PreferenceProblem.SHARED_KEY(path=path, key=key, one=owner[key], other=action.id)
                    raise PreferenceError(shared)
                owner[key] = action.id
    return keymap


def _read(path: Path) -> object:
    """Return a file's content, or an empty mapping if it is missing or empty."""
    try:
        loaded = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise PreferenceError(f"{path}: {error}") from None
    return {} if loaded is None else loaded


def _settings_problem(path: Path, settings: object) -> str:
    """Return the first mistake in the settings, or an empty string."""
    if not isinstance(settings, dict):
        return PreferenceProblem.NO_SETTINGS(path=path)
    known = sorted({*SETTINGS_OF_CORE, *feature_settings()})
    unknown = [str(name) for name in settings if name not in known]
    if absent := next((name for name in unknown if name in BRINGS_SETTINGS), ""):
        return PreferenceProblem.OF_FEATURE(path=path, feature=BRINGS_SETTINGS[absent], name=absent)
    if unknown:
        listed = join_first(known, len(known))
        return PreferenceProblem.UNKNOWN_SETTINGS(path=path, names=", ".join(unknown), known=listed)
    if not isinstance(settings.get("bell", False), bool):
        return PreferenceProblem.NO_BELL(path=path)
    if not isinstance(settings.get("notify", False), bool):
        return PreferenceProblem.NO_NOTIFY(path=path)
    if settings.get("refresh_rate", REFRESH_RATES[0]) not in REFRESH_RATES:
        return PreferenceProblem.NO_RATE(path=path, rates=", ".join(f"{rate:g}" for rate in REFRESH_RATES))
    columns = settings.get("columns", [])
    if not isinstance(columns, list) or any(column not in TOPIC_COLUMNS for column in columns):
        return PreferenceProblem.NO_COLUMNS(path=path, columns=", ".join(TOPIC_COLUMNS))
    try:
        TerminalSettings.read(settings.get("terminal", {}))
        _of_features(settings)
    except ValueError as error:
        return PreferenceProblem.BY_FEATURE(path=path, mistake=error)
    return ""


def _of_features(settings: dict[str, Any]) -> dict[str, Any]:
    """Return the values of the features' settings, or raise ValueError with the first mistake."""
    return {name: setting.read(settings[name]) for name, setting in feature_settings().items() if name in settings}


def split_keys(keys: str) -> Iterable[str]:
    return (key.strip() for key in keys.split(",") if key.strip())


class Preferences:
    """The themes and keys to use.

    Args:
        config: the user's folder, perhaps with ``themes/``, ``keys.yaml`` and ``console.yaml``.
        theme: the name of a theme, or None for one that suits the terminal.

    Attributes:
        theme: the name of the one to begin with.
        suits_terminal: whether nobody chose it, so it may change once the terminal tells its colours.
        keymap: action ids to the user's keys.
        actions: of the console, and those that the settings make.
        bell: whether the terminal's bell for new faults is on at the start.
        notify: whether the desktop gets a notification when the bell rings.
        refresh_rate: one of `REFRESH_RATES`, or None for one that suits the line.
        columns: some of `TOPIC_COLUMNS`, or None for all that fit.
        features: values of the features' settings that the user has written, by name; `ConsoleSetting.of` reads them.
        terminal: what the user has set about the terminal.
        problems: titles and texts of mistakes.
    """

    def __init__(self, config: Path, theme: str | None) -> None:
        self.problems: list[tuple[str, str]] = []
        self._path = config / "console.yaml"
        settings = self._load_settings()
        self.bell: bool = settings.get("bell", False)
        self.notify: bool = settings.get("notify", False)
        self.refresh_rate: float | None = settings.get("refresh_rate")
        self.columns: frozenset[str] | None = frozenset(settings["columns"]) if "columns" in settings else None
        self.terminal = TerminalSettings.read(settings.get("terminal", {}))
        self.features: dict[str, Any] = _of_features(settings)
        self.theme = self._load_themes(config, settings.get("theme") if theme is None else theme)
        try:
            self.keymap = load_keymap(config / "keys.yaml")
        except PreferenceError as error:
            self.keymap = {}
            self.problems.append(("The default keys are used", str(error)))
        self.actions = self._all_actions()

    def change_by_others(self) -> str:
        """Return the reason why another user can change ``console.yaml``, or an empty string."""
        return change_by_others(self._path) if is_there(self._path) else ""

    def _all_actions(self) -> tuple[Action, ...]:
        actions = [*ACTIONS]
        owner = {key: action.id for action in actions for key in self.keys(action)}
        for action in added("own_actions", self):
            if shared := next((key for key in self.keys(action) if key in owner), ""):
                names = {"key": shared, "one": owner[shared], "other": action.id}
                self.problems.append(("A key left out", PreferenceProblem.SHARED_KEY(path=self._path, **names)))
            else:
                actions.append(action)
                owner |= dict.fromkeys(self.keys(action), action.id)
        return tuple(actions)

    def _load_themes(self, config: Path, wanted: str | None) -> str:
        self.themes, problems = load_themes(shipped_themes(), config / "themes")
        if wanted is not None and wanted not in self.themes:
            problems.append(PreferenceProblem.UNKNOWN_THEME(theme=wanted, themes=", ".join(self.themes)))
            wanted = None
        if problems:
            self.problems.append(("Themes skipped", "\n".join(problems)))
        self.suits_terminal = wanted is None
        return wanted or default_theme()

    def _load_settings(self) -> dict[str, Any]:
        try:
            settings = _read(self._path)
            if problem := _settings_problem(self._path, settings):
                raise PreferenceError(problem)
        except PreferenceError as error:
            self.problems.append(("The default settings are used", str(error)))
            return {}
        return cast("dict[str, Any]", settings)

    def remember(self, name: str, value: Setting) -> None:
        """Write a setting that the operator chose; the rest of the file stays. Raise PreferenceError if that fails."""
        # On one line, so that the rest of the file stays as it is.
        line = yaml.safe_dump({name: value}, default_flow_style=True, width=math.inf, allow_unicode=True).strip()[1:-1]
        settings = _read(self._path)
        if problem := _settings_problem(self._path, settings):
            raise PreferenceError(problem)
        try:
            text = self._path.read_text(encoding="utf-8") if is_there(self._path) else ""
            found = re.search(_SETTING.format(name=name), text, re.MULTILINE)
            if found is not None:
                text = f"{text[: found.start()]}{line}{found['comment'] or ''}{text[found.end() :]}"
            else:
                text = f"{text}\n" if text and not text.endswith("\n") else text
                text += f"{line}\n"
            try:
                written = yaml.safe_load(text)
            except yaml.YAMLError:
                written = None
            if written != {**cast("dict[str, Any]", settings), name: value}:
                raise PreferenceError(PreferenceProblem.LAYOUT(path=self._path, line=line))
            make_folder(self._path.parent)
            if name in feature_settings():
                self.features[name] = feature_settings()[name].read(value)
            replace_file(self._path, text.encode())
        except OSError as error:
            raise PreferenceError(f"{self._path}: {why_not_written(error, self._path)}") from None

    def keys(self, action: Action) -> list[str]:
        """Return an action's keys, by Textual's names."""
        return list(split_keys(self.keymap.get(action.id, action.keys)))

    def key_labels(self, action: Action, *, ascii_only: bool) -> list[str]:
        """Return an action's keys as they are written on a keyboard."""
        signs = KEY_SIGNS if ascii_only else KEY_SIGNS | UNICODE_KEY_SIGNS
        return [signs.get(key, key.replace("ctrl+", "^")) for key in self.keys(action)]
