"""Themes: the shipped ones are readable, a user's mistake is explained."""

from pathlib import Path
from typing import Any

import pytest
from tests.console.driving import gone, notices, notified, on_main, shown, text
from tests.support.wording import says
from textual.color import Color
from textual.pilot import Pilot

from rsb_console import preferences
from rsb_console.app import ConsoleApp
from rsb_console.notation.console_setting import SETTINGS_OF_CORE, ConsoleSetting
from rsb_console.preferences import PreferenceProblem, ThemeProblem
from rsb_console.terminal.terminal_facts import TerminalFacts
from rsb_console.widgets import topics

SHIPPED, PROBLEMS = preferences.load_themes(preferences.shipped_themes())


def luminance(color: str) -> float:
    """Relative luminance (WCAG 2.2)."""
    parts = [c / 255 for c in Color.parse(color).rgb]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    """Contrast ratio (WCAG 2.2)."""
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_five_are_shipped_without_a_mistake() -> None:
    assert set(SHIPPED) == {"dark", "light", "high-contrast", "terminal", "terminal-light"}
    assert PROBLEMS == []


@pytest.mark.parametrize(("name", "least"), [("dark", 4.5), ("light", 4.5), ("high-contrast", 7.0)])
def test_what_is_read_stands_out(name: str, least: float) -> None:
    theme = SHIPPED[name]
    assert theme.background is not None
    assert theme.panel is not None
    for look in ("foreground", "success", "warning", "error", "primary", "secondary", "accent"):
        for ground in (theme.background, theme.panel, theme.variables["row-cursor"]):
            assert contrast(getattr(theme, look), ground) >= least, (look, ground)
    assert contrast(theme.variables["quiet"], theme.background) >= 4.5
    assert contrast(theme.variables["alarm"], theme.variables["alarm-background"]) >= 4.5


@pytest.mark.parametrize("name", ["dark", "light"])
def test_colours_are_of_the_256(name: str) -> None:
    """A terminal without COLORTERM shows the intended colours."""
    levels = {0, 95, 135, 175, 215, 255}
    theme = SHIPPED[name]
    for key in preferences.THEME_COLORS:
        color = getattr(theme, key)
        if color is not None:
            rgb = Color.parse(color).rgb
            grey = rgb[0] == rgb[1] == rgb[2] and (rgb[0] - 8) % 10 == 0
            assert grey or set(rgb) <= levels, (key, color)


@pytest.mark.parametrize("name", ["terminal", "terminal-light"])
def test_the_terminal_theme_names_the_terminals_own_colours(name: str) -> None:
    theme = SHIPPED[name]
    assert theme.ansi
    used = [getattr(theme, key) for key in preferences.THEME_COLORS] + list(theme.variables.values())
    assert all(color is None or color.startswith("ansi_") for color in used)


@pytest.mark.parametrize(
    ("content", "problem", "parameters"),
    [
        ("", ThemeProblem.NO_MAPPING, {}),
        ("- red", ThemeProblem.NO_MAPPING, {}),
        ("dark: true", ThemeProblem.KEY_MISSING, {"key": "primary"}),
        ('primary: "#12345"', ThemeProblem.NO_COLOR, {"key": "primary", "value": "#12345"}),
        ("primary: 7", ThemeProblem.NO_COLOR, {"key": "primary", "value": 7}),
        ("primary: red\ncolour: blue", ThemeProblem.UNKNOWN_KEYS, {"keys": "colour"}),
        ("primary: red\ndark: maybe", ThemeProblem.NO_SWITCH, {"key": "dark", "value": "maybe"}),
        ("primary: red\nvariables: [1]", ThemeProblem.NO_VARIABLES, {}),
        (
            "primary: red\nvariables: {row-cursor: nope}",
            ThemeProblem.NO_COLOR,
            {"key": "variables.row-cursor", "value": "nope"},
        ),
    ],
)
def test_a_mistake_is_reported(
    tmp_path: Path, content: str, problem: ThemeProblem, parameters: dict[str, object]
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(content)
    found, (reported,) = preferences.load_themes(tmp_path)
    assert found == {}
    assert reported.startswith(str(path))
    assert says(reported, problem, **parameters)


def test_file_with_broken_yaml_names_line(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("primary: [")
    _, (reported,) = preferences.load_themes(tmp_path)
    assert reported.startswith(str(path))
    assert "line 1" in reported


def test_users_theme_joins_or_replaces_shipped_ones(tmp_path: Path) -> None:
    (tmp_path / "dark.yaml").write_text('primary: "#ffffff"')
    found, _ = preferences.load_themes(preferences.shipped_themes(), tmp_path)
    assert found["dark"].primary == "#ffffff"
    assert "light" in found


def own_themes() -> dict[str, Any]:
    """A folder of the user's with a good theme and a bad one."""
    Path("themes").mkdir()
    Path("themes/bad.yaml").write_text("primary: nope")
    Path("themes/mine.yaml").write_text('primary: "#ff00ff"')
    return {"config": Path().resolve()}


@pytest.mark.usefixtures("folder")
@on_main(landmark="Themes skipped", theme="mine", before=own_themes)
async def test_bad_themes_are_one_toast_rest_works(app: ConsoleApp, pilot: Pilot[None]) -> None:
    assert app.theme == "mine"
    assert len(notices(app)) == 1


@on_main(theme="nope")
async def test_an_unknown_theme_falls_back_and_is_named(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await notified(pilot, PreferenceProblem.UNKNOWN_THEME, theme="nope")
    assert app.theme == "dark"


def test_a_light_background_has_no_yellow_or_cyan() -> None:
    theme = SHIPPED["terminal-light"]
    used = [getattr(theme, key) for key in preferences.THEME_COLORS] + list(theme.variables.values())
    assert not [color for color in used if color is not None and ("yellow" in color or "cyan" in color)]


@on_main(theme="terminal")
async def test_the_terminal_theme_suits_a_light_background(app: ConsoleApp, pilot: Pilot[None]) -> None:
    app.suit_terminal(TerminalFacts(light=False, colours=16))
    assert app.theme == "terminal"
    app.suit_terminal(TerminalFacts(light=True, colours=16))
    assert app.theme == "terminal-light"
    app.theme = "dark"
    app.suit_terminal(TerminalFacts(light=True, colours=16))
    assert app.theme == "dark"


@on_main(theme="terminal")
async def test_a_dialog_leaves_what_is_behind_in_sight(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("q")
    await shown(pilot, "Quit?")
    assert "/robot2/scan" in text(app)


@pytest.mark.usefixtures("folder")
@on_main(before=lambda: {"config": Path().resolve(), "theme": None})
async def test_choices_are_kept_for_the_next_start(app: ConsoleApp, pilot: Pilot[None]) -> None:
    Path("console.yaml").write_text("# mine\nbell: true  # loud\n")
    await pilot.press("t", "minus", "exclamation_mark")
    kept = preferences.Preferences(Path(), None)
    assert (kept.theme, kept.refresh_rate, kept.bell) == (app.theme, 2.0, True)
    await pilot.press("exclamation_mark")
    assert Path("console.yaml").read_text() == f"# mine\nbell: false  # loud\ntheme: {app.theme}\nrefresh_rate: 2.0\n"
    assert preferences.Preferences(Path(), "light").theme == "light", "an option comes first"


@pytest.mark.parametrize("text", ["{bell: true}\n", "bell: [\n", "bel: true\n"])
def test_choice_leaves_file_alone_that_it_cannot_edit(tmp_path: Path, text: str) -> None:
    path = tmp_path / "console.yaml"
    path.write_text(text)
    with pytest.raises(preferences.PreferenceError):
        preferences.Preferences(tmp_path, None).remember("theme", "light")
    assert path.read_text() == text


@pytest.mark.parametrize(
    ("text", "problem", "parameters"),
    [
        ("[bell]", PreferenceProblem.NO_SETTINGS, {}),
        ("bel: true", PreferenceProblem.UNKNOWN_SETTINGS, {"names": "bel"}),
        ("bell: loud", PreferenceProblem.NO_BELL, {}),
        ("notify: loud", PreferenceProblem.NO_NOTIFY, {}),
        ("refresh_rate: 3", PreferenceProblem.NO_RATE, {}),
        ("columns: [AGES]", PreferenceProblem.NO_COLUMNS, {}),
        ("columns: AGE", PreferenceProblem.NO_COLUMNS, {}),
    ],
)
def test_a_mistake_in_the_settings_is_named(
    tmp_path: Path, text: str, problem: PreferenceProblem, parameters: dict[str, object]
) -> None:
    (tmp_path / "console.yaml").write_text(text)
    ((_, reported),) = preferences.Preferences(tmp_path, None).problems
    assert says(reported, problem, **parameters)


def read_tiles(given: object) -> tuple[str, ...]:
    if not isinstance(given, list):
        raise ValueError("tiles: give a list")  # noqa: TRY004 -- as the door says
    return tuple(map(str, given))


TILES = ConsoleSetting[tuple[str, ...]]("tiles", (), read_tiles)


@pytest.fixture
def tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """A feature has the setting `TILES`."""
    monkeypatch.setattr(preferences, "feature_settings", lambda: {TILES.name: TILES})


@pytest.mark.usefixtures("tiles")
def test_setting_of_a_feature_is_read_and_kept(tmp_path: Path) -> None:
    file = tmp_path / "console.yaml"
    file.write_text("tiles: [map, scan]\n")
    preferences.Preferences(tmp_path, None).remember("bell", True)
    kept = preferences.Preferences(tmp_path, None)
    assert (TILES.of(kept), kept.bell, kept.problems) == (("map", "scan"), True, [])
    file.unlink()
    assert TILES.of(preferences.Preferences(tmp_path, None)) == ()


@pytest.mark.usefixtures("tiles")
def test_mistake_in_feature_setting_has_its_file(tmp_path: Path) -> None:
    file = tmp_path / "console.yaml"
    file.write_text("bell: true\ntiles: map\n")
    found = preferences.Preferences(tmp_path, None)
    assert [text for _, text in found.problems] == [f"{file}: tiles: give a list"]
    assert (TILES.of(found), found.bell) == ((), False)


@pytest.mark.usefixtures("tiles")
def test_unknown_setting_lists_those_of_features(tmp_path: Path) -> None:
    (tmp_path / "console.yaml").write_text("tile: []")
    ((_, reported),) = preferences.Preferences(tmp_path, None).problems
    *own, last = sorted(SETTINGS_OF_CORE)
    assert says(reported, PreferenceProblem.UNKNOWN_SETTINGS, known=f"{', '.join((*own, last))} and tiles")


def chosen_columns() -> dict[str, object]:
    Path("console.yaml").write_text("columns: [AGE, VIA]")
    return {"config": Path().resolve()}


@pytest.mark.usefixtures("folder")
@on_main(before=chosen_columns)
async def test_only_chosen_columns_are_shown(app: ConsoleApp, pilot: Pilot[None]) -> None:
    assert [column.title for column, _ in app.main.topics.columns] == ["STATE", "TOPIC", "VIA", "AGE"]


def titles(app: ConsoleApp) -> list[str]:
    return [column.title.strip() for column, _ in app.main.topics.columns]


def own_folder() -> dict[str, object]:
    return {"config": Path().resolve()}


@pytest.mark.usefixtures("folder")
@on_main((80, 24), (120, 36), before=own_folder)
async def test_chosen_columns_are_shown_and_kept(app: ConsoleApp, pilot: Pilot[None]) -> None:
    before = titles(app)
    await pilot.press("vertical_line", "j", "j", "enter")
    await shown(pilot, f"  VIA          {preferences.TOPIC_COLUMNS['VIA']}")
    assert "VIA" in before
    assert "VIA" not in titles(app)
    assert preferences.Preferences(Path(), None).columns == frozenset(preferences.TOPIC_COLUMNS) - {"VIA"}
    await pilot.press("enter", "escape")
    await gone(pilot, "show or hide")
    assert titles(app) == before
    assert Path("console.yaml").read_text() == f"columns: [{', '.join(preferences.TOPIC_COLUMNS)}]\n"


@pytest.mark.usefixtures("folder")
@on_main((80, 24), (120, 36), before=own_folder)
async def test_hidden_columns_make_room_for_chosen_ones(app: ConsoleApp, pilot: Pilot[None]) -> None:
    assert "TOTAL" not in titles(app)
    await pilot.press("vertical_line")
    await shown(pilot, "bytes in all: no room")
    await shown(pilot, "a node's time for a call: nothing to show")
    for down in (2, 1, 1, 2):  # VIA, HZ/EXP, kB/s and ms
        await pilot.press(*"j" * down, "space")
    assert titles(app) == ["STATE", "TOPIC", "TOTAL", "AGE", "HISTORY"]


def test_every_column_can_be_chosen() -> None:
    assert {column.title.strip() for column in topics.COLUMNS} == {"", "STATE", "TOPIC", *preferences.TOPIC_COLUMNS}


@pytest.mark.parametrize(
    ("environ", "expected"),
    [
        ({"TERM": "xterm-256color"}, "dark"),
        ({"TERM": "xterm", "COLORTERM": "truecolor"}, "dark"),
        ({"TERM": "tmux-256color"}, "dark"),
        ({"TERM": "screen"}, "terminal"),
        ({"TERM": "linux"}, "terminal"),
        ({"TERM": "xterm"}, "terminal"),
        ({}, "terminal"),
    ],
)
def test_the_default_suits_the_terminal(environ: dict[str, str], expected: str) -> None:
    assert preferences.default_theme(environ) == expected


@on_main()
async def test_t_goes_through_all_themes(app: ConsoleApp, pilot: Pilot[None]) -> None:
    seen = {app.theme}
    for _ in SHIPPED:
        await pilot.press("t")
        seen.add(app.theme)
    assert seen == set(SHIPPED)
