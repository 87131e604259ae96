"""One registry: keys, footer, help and palette agree, and nothing is beyond reach."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.console.driving import (
    Decorator,
    drive,
    engine_of,
    gone,
    notices,
    on_main,
    put,
    scripted_app,
    settled,
    shown,
    text,
    until,
)
from tests.console.scripted import CALL_ROUTES, ROUTES, route
from tests.support.wording import pattern, says
from textual.binding import Binding
from textual.color import Color
from textual.pilot import Pilot
from textual.screen import Screen

from rsb_bridge.model.commands import Effect
from rsb_bridge.model.snapshot import ArmingSnapshot, State
from rsb_console.actions.action import Group
from rsb_console.actions.all_actions import ACTIONS, BY_ID, KEYS_ON_SCREENS, bindings
from rsb_console.app import ConsoleApp
from rsb_console.preferences import PreferenceError, PreferenceProblem, load_keymap, split_keys
from rsb_console.screens.dialog import ConfirmScreen
from rsb_console.screens.help import ActionsProvider, HelpScreen
from rsb_console.screens.links_screen import LinksScreen
from rsb_console.screens.main import MainText
from rsb_console.screens.message_screen import MessageScreen
from rsb_console.screens.topic_form import TopicScreen
from rsb_console.screens.welcome_screen import WelcomeScreen
from rsb_console.widgets.form import FormScreen

EATEN = {"ctrl+s", "ctrl+q", "ctrl+a", "ctrl+b", "ctrl+j", "ctrl+enter"}


def test_every_action_has_its_handler() -> None:
    app = scripted_app()
    for action in ACTIONS:
        owner = {Group.MOVE: app.main.topics, Group.CONSOLE: app}.get(action.group, app.main)
        assert callable(getattr(owner, f"action_{action.id}"))


def test_no_id_and_no_key_twice() -> None:
    keys = [key for action in ACTIONS for key in split_keys(action.keys)]
    assert len(set(keys)) == len(keys)
    assert len({action.id for action in ACTIONS}) == len(ACTIONS)
    assert set(BY_ID) == {action.id for action in ACTIONS}


def test_no_action_hangs_on_key_that_terminals_eat() -> None:
    for action in ACTIONS:
        assert any(key not in EATEN and not key.startswith("alt+") for key in split_keys(action.keys)), action.id


@pytest.mark.parametrize(
    ("content", "problem", "parameters"),
    [
        ("- pause", PreferenceProblem.NO_KEYMAP, {}),
        ("pawse: P", PreferenceProblem.UNKNOWN_ACTIONS, {"actions": "pawse"}),
        ("pause: r", PreferenceProblem.SHARED_KEY, {"key": "r", "one": "pause", "other": "retry"}),
    ],
)
def test_a_mistake_in_the_users_keys_is_reported(
    tmp_path: Path, content: str, problem: PreferenceProblem, parameters: dict[str, object]
) -> None:
    path = tmp_path / "keys.yaml"
    path.write_text(content)
    with pytest.raises(PreferenceError, match=pattern(problem, path=path, **parameters)):
        load_keymap(path)


def test_keys_with_broken_yaml_name_line(tmp_path: Path) -> None:
    path = tmp_path / "keys.yaml"
    path.write_text("pause: [")
    with pytest.raises(PreferenceError, match=r"keys\.yaml(.|\n)*line 1"):
        load_keymap(path)


def test_no_file_and_an_empty_one_change_nothing(tmp_path: Path) -> None:
    assert load_keymap(tmp_path / "keys.yaml") == {}
    (tmp_path / "keys.yaml").write_text("# nothing yet\n")
    assert load_keymap(tmp_path / "keys.yaml") == {}


def with_keys(content: str, landmark: str) -> Decorator:
    """A test's steps run with a user's keys."""

    def written() -> dict[str, Any]:
        Path("keys.yaml").write_text(content)
        return {"config": Path().resolve()}

    return on_main(landmark=landmark, before=written)


@pytest.mark.usefixtures("folder")
@with_keys("pause: Z\nmove_down: ctrl+n\n", "Z pause")
async def test_a_remapped_key_works_and_is_shown(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("p")
    await pilot.press("ctrl+n", "Z")
    await until(pilot, lambda: engine_of(app).commands, "a command")
    assert engine_of(app).commands == [("pause", "/robot1/map", True)]


@pytest.mark.usefixtures("folder")
@with_keys("pawse: P", "pawse")
async def test_bad_keys_leave_the_default_ones(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await shown(pilot, "p pause")
    await pilot.press("p")
    await until(pilot, lambda: engine_of(app).commands, "a command")


@pytest.mark.parametrize("width", [120, 80])
def test_help_lists_every_action_with_keys(width: int) -> None:
    app = scripted_app()

    async def steps(pilot: Pilot[None]) -> None:
        await pilot.press("question_mark")
        await shown(pilot, "Next line")
        cells = [line.strip(" │").split("  ") for line in text(app).splitlines()]
        words = {cell.strip() for line in cells for cell in line}
        for action in ACTIONS:
            assert {app.key_labels(action)[0], action.id} <= words
            assert width < 120 or action.help in words
        await shown(pilot, "pause: P")
        await pilot.press("escape")
        await gone(pilot, "Next line")

    drive(app, steps, size=(width, 200))


def screens(app: ConsoleApp) -> dict[str, Callable[[], Screen[Any]]]:
    return {
        "messages": lambda: MessageScreen(app, route("/map")),
        "welcome": lambda: WelcomeScreen((), readonly=False),
        "question": lambda: ConfirmScreen("Remove?", "", "Remove", Effect.LOSES),
        "links": lambda: LinksScreen(app),
    }


@on_main()
async def test_every_screen_shows_the_keys(app: ConsoleApp, pilot: Pilot[None]) -> None:
    for make in screens(app).values():
        app.push_screen(make())
        await pilot.pause()
        below = app.screen
        for key in ("question_mark", "f1"):
            await pilot.press(key)
            await until(pilot, lambda: isinstance(app.screen, HelpScreen), "the keys")
            await pilot.press(key)
            await until(pilot, lambda below=below: app.screen is below, "the screen below")
        app.pop_screen()


@pytest.mark.parametrize("name", ["messages", "welcome"])
@on_main()
async def test_a_new_session_from_other_screens(app: ConsoleApp, pilot: Pilot[None], name: str) -> None:
    if name == "welcome":
        await pilot.press("f5")
        await until(pilot, lambda: isinstance(app.screen, WelcomeScreen), "the welcome")
    else:
        app.push_screen(screens(app)[name]())
        await pilot.pause()
    await pilot.press("f2")
    await shown(pilot, "New session")
    await until(pilot, lambda: isinstance(app.screen, FormScreen), "the form")


def test_the_keys_of_forms_are_listed() -> None:
    listed = " ".join(keys for chapter in KEYS_ON_SCREENS for keys, _ in chapter.keys).split()
    labels = {"plus": "+", "minus": "-", "space": "space", "escape": "esc", "enter": "⏎", "less_than_sign": "<",
              "greater_than_sign": ">", "left_square_bracket": "[", "right_square_bracket": "]", "left": "←",
              "right": "→", "up": "↑", "down": "↓", "equals_sign": "+", "f7": "F7", "f8": "F8"}  # fmt: skip
    for screen in (TopicScreen,):
        for binding in screen.BINDINGS:
            assert isinstance(binding, Binding)
            for each in binding.key.split(","):
                assert labels.get(each, each) in [*listed, "d"], (screen, each)


@on_main()
async def test_the_palette_begins_with_what_is_likely(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("colon")
    await shown(pilot, BY_ID["add_topic"].help)
    picture = text(app)
    assert BY_ID["move_down"].help not in picture
    border = app.screen.query_one("#--input").styles.border_top[1]
    assert border.hex == Color.parse(app.current_theme.primary).hex


@on_main()
@pytest.mark.parametrize(
    ("typed", "first"), [("paus", "pause"), ("record", "record"), ("rest", "restart"), ("link", "links")]
)
async def test_palette_puts_names_before_scattered_letters(
    app: ConsoleApp, pilot: Pilot[None], typed: str, first: str
) -> None:
    provider = ActionsProvider(app.screen)
    found = [hit async for hit in provider.search(typed)]
    (best,) = (each.help for each in ACTIONS if each.id == first)
    assert str(max(found, key=lambda hit: hit.score).text) == best


@on_main()
async def test_palette_finds_action_by_words_and_runs_it(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("colon", *"faults only")
    await shown(pilot, "Show faults only")
    await pilot.press("enter", "enter")
    await until(pilot, lambda: app.main.topics.faults_only, "faults only")


DISARMED = route("/cmd_vel", State.DISARMED, outgoing=True, arming=ArmingSnapshot(armed=False))


@on_main((120, 80), landmark="read-only", readonly=True)
async def test_readonly_takes_away_whatever_changes_something(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await gone(pilot, "p pause")
    await pilot.press("c", "i")  # nor is a link acknowledged
    await pilot.press("escape")
    for faulty in (ROUTES[4], DISARMED, CALL_ROUTES[0]):
        put(app, faulty)
        await gone(pilot, "C call")
        for key in (*"aedpiuACSDrRowW", "f2", "f3", "f4", "f5", "f6"):
            app.clear_notifications()
            await pilot.press(key)
            assert app.screen is app.main, key
            await until(pilot, lambda: notices(app), key)
            assert says(notices(app)[0].message, MainText.READ_ONLY), key
    await settled(pilot)
    assert app.screen is app.main
    await pilot.press("question_mark")
    await shown(pilot, "Next line")
    assert not any(action.help in text(app) for action in ACTIONS if action.changes)
    assert engine_of(app).commands == []


@on_main((120, 36), (40, 15), landmark="? help  q quit")
async def test_the_footer_always_ends_with_help_and_quit(app: ConsoleApp, pilot: Pilot[None]) -> None:
    assert text(app).splitlines()[-1].rstrip().endswith("? help  q quit")


def test_action_whose_keys_are_taken_binds_none() -> None:
    """A feature's key may be another's: Textual refuses a binding without a key."""
    bare = replace(BY_ID["help"], keys="")
    assert bindings(bare.group, actions=(bare,)) == []
