"""Themes, one per YAML file: the shipped ones and the user's own.

A file holds Textual's theme colours (``primary: "#5fafff"``, ...), ``dark: true`` or ``false``, ``ansi: true`` for
the terminal's own sixteen colours (``ansi_green``), and ``variables`` for single CSS variables. The file's name is the
theme's.
"""

from __future__ import annotations

import os
import sysconfig
from pathlib import Path
from typing import Any

import yaml
from platformdirs import user_config_path
from textual.color import Color, ColorParseError
from textual.theme import Theme

from rsb_bridge.model.wording import Wording

REQUIRED = ("primary",)
COLORS = ("secondary", "warning", "error", "success", "accent", "foreground", "background", "surface", "panel", "boost")
SWITCHES = ("dark", "ansi")
DEFAULT, SIXTEEN_COLORS = "dark", "terminal"

VARIABLES = {
    "row-cursor": "#303030",
    "row-cursor-blurred": "#262626",
    "alarm": "#ffffff",
    "alarm-background": "#d70000",
    "quiet": "#808080",
    "rule": "#444444",
}
"""Defaults of the variables that our style sheet adds to Textual's."""


class ThemeProblem(Wording):
    """Mistakes in a theme file."""

    NO_MAPPING = 'must map names to colours, like primary: "#5fafff"'
    UNKNOWN_KEYS = "{keys}: not part of a theme; it has {known}"
    KEY_MISSING = "{key} is missing"
    NO_SWITCH = "{key}: {value!r} is neither true nor false"
    NO_VARIABLES = "variables: must map names to values"
    NO_COLOR = '{key}: {value!r} is not a colour; give "#rrggbb" in quotes, or a name'


def config_path() -> Path:
    """Return the user's configuration folder, with ``keys.yaml`` and ``themes/``."""
    return user_config_path("rsb-console")


def shipped_path() -> Path:
    """Return the folder of the shipped themes: next to the packages in a checkout, or in the installed shared data."""
    checkout = Path(__file__).parents[3]
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
            found[path.stem] = read_theme(path)
        except (ThemeError, OSError, UnicodeDecodeError) as error:
            problems.append(f"{path}: {error}")
    return found, problems


class ThemeError(ValueError):
    """A mistake in a theme file; the message is for the user."""


def read_theme(path: Path) -> Theme:
    """Read one theme.

    Raises:
        ThemeError: it has a mistake.
        OSError: it cannot be read.
    """
    try:
        loaded = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        # On one line, as all mistakes together are one toast.
        raise ThemeError(" ".join(str(error).split())) from None
    if not isinstance(loaded, dict):
        raise ThemeError(ThemeProblem.NO_MAPPING())
    unknown = sorted(str(key) for key in loaded if key not in {*REQUIRED, *COLORS, *SWITCHES, "variables"})
    if unknown:
        raise ThemeError(ThemeProblem.UNKNOWN_KEYS(keys=", ".join(unknown), known=", ".join((*REQUIRED, *COLORS))))
    for key in REQUIRED:
        if key not in loaded:
            raise ThemeError(ThemeProblem.KEY_MISSING(key=key))
    for key in (*REQUIRED, *COLORS):
        if key in loaded:
            _check_color(key, loaded[key])
    for key in SWITCHES:
        if not isinstance(loaded.get(key, True), bool):
            raise ThemeError(ThemeProblem.NO_SWITCH(key=key, value=loaded[key]))
    variables = loaded.pop("variables", {})
    if not isinstance(variables, dict):
        raise ThemeError(ThemeProblem.NO_VARIABLES())
    for key, value in variables.items():
        if key in VARIABLES:  # Textual's own may be no colours, such as a style
            _check_color(f"variables.{key}", value)
    return Theme(name=path.stem, variables={str(key): str(value) for key, value in variables.items()}, **loaded)


def _check_color(key: str, value: Any) -> None:
    try:
        Color.parse(value)
    except (ColorParseError, TypeError, AttributeError):  # no text: to YAML, #5fafff without quotes is a comment
        raise ThemeError(ThemeProblem.NO_COLOR(key=key, value=value)) from None


def default_theme(environ: dict[str, str] | os._Environ[str] = os.environ) -> str:
    """Return the theme that suits this terminal: one of sixteen colours if the terminal announces no more."""
    many = environ.get("COLORTERM") in {"truecolor", "24bit"} or "256color" in environ.get("TERM", "")
    return DEFAULT if many else SIXTEEN_COLORS
