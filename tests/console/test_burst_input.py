"""Input that arrives in one read, as a slow line delivers it: every key has the effect that it has alone."""

import asyncio
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from tests.console.driving import drive, engine_of, form_of, on_main, on_welcome, scripted_app, send, shown, until
from tests.console.scripted import SESSION
from tests.console.tmux import Tmux
from tests.support import constants
from tests.support.long import long
from textual.app import App
from textual.events import Key, Paste
from textual.keys import _character_to_key
from textual.pilot import Pilot

from rsb_bridge.config.session_file import save
from rsb_console.app import ConsoleApp
from rsb_console.screens.new_session import NewSessionScreen
from rsb_console.screens.save_screens import SaveText
from rsb_console.terminal.driver import KeyParser
from rsb_console.widgets.controls import FieldInput

SENTENCE = "the quick brown fox jumps over y n q/the lazy dog 0123456789"
F8 = "\x1b[19~"
"""It unfolds a form, and goes to the first field that appears."""
MOST = 3
"""Fields of a form: the way from one to the next is the same for all."""
CONTROL = {"\t": "tab", "\r": "enter", "\x1b": "escape", "\x7f": "backspace"}
FORMS = {  # the keys that open each form, and words in it
    "Add a topic": ("a", "Direction"),
    "Edit": ("e", "Direction"),
    "Sessions": ("o", "↑ ↓ and ⏎"),
    "Save as": ("W", SaveText.RELATIVE_KEYS()),
    "New session": (["f2"], "Encryption"),
    "Import": (["f3"], "Session file"),
    "Generate a key": ("Kg", "Generate a key"),
}


def burst(app: App[None], keys: Sequence[str]) -> None:
    """Type all keys before the app looks at the first."""
    for key in keys:
        named = CONTROL.get(key) or (key if len(key) > 1 else _character_to_key(key))
        send(app, Key(named, key if len(key) == 1 else None))


def opened(words: str, keys: Sequence[str]) -> dict[str, int]:
    """The text fields of a form in the order of tabs, and how many tabs lead to each."""
    places: dict[str, int] = {}
    app = scripted_app()

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        await pilot.press(*keys)
        await shown(pilot, words)
        fields = form_of(app).fields
        await until(pilot, lambda: app.focused is not None, "the focus")
        focusable = list(app.screen.focus_chain)
        assert app.focused is not None
        start = focusable.index(app.focused)
        for key, field in fields.items():
            if isinstance(field.control, FieldInput) and field.display:
                places[key] = focusable.index(field.control) - start

    drive(app, steps)
    return dict(sorted(places.items(), key=lambda each: each[1]))


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    "form", ["Add a topic", "Generate a key", *long("New session", "Edit", "Sessions", "Save as", "Import")]
)
def test_sentence_after_opening_key_fills_fields(form: str) -> None:
    keys, words = FORMS[form]
    places = dict(list(opened(words, keys).items())[:MOST])
    assert places
    # Every character goes into the first field, right behind the key that opens the form; the others get a few.
    sentences = dict(zip(places, (SENTENCE, "y n", "q/0"), strict=False))
    at, pressed = 0, list(keys)
    for name, place in places.items():
        # The first backspace ends the selection: a field that is edited begins with its value's end.
        typed = ["ctrl+u", "home", *"\x7f", *sentences[name], "X", "left", "delete", "home", ">", "end", "<"]
        pressed += [*["tab"] * (place - at), *typed]
        at = place
    app = scripted_app()

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        burst(app, pressed)
        await shown(pilot, words)
        controls = {name: form_of(app).fields[name].control for name in places}
        *_, last = controls.values()

        def so_far() -> list[str]:
            return [control.value for control in controls.values()]

        while not last.value.endswith("<"):  # hundreds of keys, each of which may take a second
            before = so_far()
            await until(pilot, lambda before=before: so_far() != before, "the next key")
        assert {name: control.value for name, control in controls.items()} == {
            name: f">{sentence}<" for name, sentence in sentences.items()
        }

    drive(app, steps)


FIELDS_TYPED = {"name": "cart3", "server_ip": "10.0.0.20", "server_port": "7070", "domain_id": "12"}
AS_SERVER = {"role": "server", **FIELDS_TYPED, "use_name": "yes", "clients": "a, b"}


FILLED = [
    ("\tcart3\t10.0.0.20\t7070\t12", FIELDS_TYPED),
    ("cart3\t10.0.0.20\t7070\t12", FIELDS_TYPED),  # at once, though the form opens at a choice
    ("server\tcart3\t10.0.0.20\t7070\t12\ty\ta, b", AS_SERVER),
    (" \tcart3\t10.0.0.20\t7070\t12\t \ta, b", AS_SERVER),
    ("s\tcart3\t10.0.0.20\t7070\t12\tyesx\t\t", {**AS_SERVER, "use_name": "no", "clients": ""}),
]
WITH_ENTER = ("\tcart3\r10.0.0.20\t7070\t12", FIELDS_TYPED)  # enter goes to what is still missing; a paste has none


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("how", "typed", "expected"),
    [
        # The first's beginning is both typed and pasted in tmux, below.
        *(pytest.param(how, *FILLED[0], marks=pytest.mark.long) for how in ("typed", "pasted")),
        *(("typed", *each) for each in (WITH_ENTER, FILLED[1], FILLED[2], FILLED[4])),
        ("pasted", *FILLED[4]),
        pytest.param("typed", *FILLED[3], marks=pytest.mark.long),
        *(pytest.param("pasted", *FILLED[at], marks=pytest.mark.long) for at in (1, 2, 3)),
    ],
)
@on_welcome()
async def test_a_new_session_is_filled_in_at_once(
    app: ConsoleApp, pilot: Pilot[None], how: str, typed: str, expected: dict[str, str]
) -> None:
    burst(app, "n" if how == "pasted" else f"n{typed}")
    await until(pilot, lambda: isinstance(app.screen, NewSessionScreen), "the form")
    if how == "pasted":
        send(app, Paste(typed))
    form = form_of(app)
    await until(pilot, lambda: form.values.items() >= expected.items(), "all values")
    await until(pilot, lambda: not app.input_queue.delivers, "all of it")
    assert form.values.items() >= expected.items()


def in_tmux(tmux: Tmux, how: str, text: str, folder: Path) -> None:
    """Type a text at once, or paste it as a terminal does."""
    if how == "typed":
        tmux("send-keys", "-l", text)
    else:
        (folder / "pasted").write_text(text)
        tmux("load-buffer", str(folder / "pasted"))
        tmux("paste-buffer", "-p", "-r")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("how", ["typed", "pasted"])
def test_in_tmux_all_forms_take_all_fields(how: str, tmp_path: Path) -> None:
    save(SESSION, Path("nav2.yaml"))
    command = shlex.join([sys.executable, "-m", "tests.console.scripted_console"])
    path = os.pathsep.join(p for p in sys.path if p)
    forms = [  # the keys that open each form, a word in it, what is typed, and how its fields look then
        (("F2",), "Encryption", "\tcart3\t10.0.0.20\t7070", ["Name           cart3 ", "Server         10.0.0.20 "]),
        (("F2",), "Encryption", "cart3\t10.0.0.20\t7070", ["Name           cart3 ", "Port           7070 "]),
        (("a",), "Direction", "/x\t\t\tstd_msgs/msg/String\t20", ["Topic          /x ", "std_msgs/msg/String ", "20 "]),
        (("W",), SaveText.RELATIVE_KEYS(), ".copy", ["nav2.yaml.copy "]),
        (("F3",), "Session file", "a.yaml\tcart3", ["a.yaml ", "cart3"]),
        (("K", "g"), "Generate a key", "2", ["2"]),
    ]
    with Tmux(tmp_path, "env", f"PYTHONPATH={path}", "sh", "-c", f"exec {command}") as tmux:
        tmux.wait_for("/robot2/scan")
        for keys, word, text, fields in forms:
            tmux("send-keys", *keys)
            if how == "pasted":
                tmux.wait_for(word)
            in_tmux(tmux, how, text, tmp_path)
            tmux.wait_for(word)
            for words in fields:
                tmux.wait_for(words)
            tmux("send-keys", "Escape")
            tmux.wait_for(word, there=False)
            if keys == ("K", "g"):
                tmux("send-keys", "Escape")


@on_main()
async def test_a_filter_and_what_follows_it(app: ConsoleApp, pilot: Pilot[None]) -> None:
    burst(app, "/odmo\x7f\x7fom\rjeX")
    await shown(pilot, "Edit /robot1/odom")
    await until(pilot, lambda: "X" in form_of(app).values.values(), "the key behind e")
    burst(app, "\x1b\x1b/robot2\rl/no route\r")
    await until(pilot, lambda: not app.main.prompt.display and app.main.log_pane.pattern, "both filters")
    texts = [pattern and pattern.text for pattern in (app.main.topics.pattern, app.main.log_pane.pattern)]
    assert texts == ["robot2", "no route"]


@on_main()
async def test_question_is_answered_by_key_behind_it(app: ConsoleApp, pilot: Pilot[None]) -> None:
    burst(app, "dn/tf\rdy")
    engine = engine_of(app)
    await until(pilot, lambda: engine.commands, "a command")
    assert engine.commands == [("remove", "/tf")]


@on_main()
async def test_the_palette_runs_what_was_typed(app: ConsoleApp, pilot: Pilot[None]) -> None:
    burst(app, ":show every key\r")
    await shown(pilot, "PgDn")


@on_main()
async def test_what_is_typed_while_app_ends_goes_nowhere(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """The app would raise its failure at its end."""
    await app._close_all()  # the first thing that Textual does then; the app's messages are handled a while longer
    app.post_message(Key("j", "j"))
    while app.message_queue_size:  # noqa: ASYNC110  # `until` would ask the app for its screen
        await asyncio.sleep(0.01)


@pytest.mark.parametrize("size", [1, 3, 100])
def test_an_answer_among_keys_loses_none(size: int) -> None:
    parser, typed = KeyParser(), "ab\x1b]11;rgb:ffff/ffff/ffff\x07c\x1b]11;rgb:0000/0000/0000\x1b\\d\x1b]e"
    found = [
        event
        for at in range(0, len(typed), size)
        for event in parser.feed(typed[at : at + size])
        if isinstance(event, Key)
    ]
    answers = [event.character for event in found if event.key == "<terminal-fact>"]
    assert answers == ["]11;rgb:ffff/ffff/ffff\x07", "]11;rgb:0000/0000/0000\x1b\\"]
    keys = [event.key for event in found if event.key != "<terminal-fact>"]
    assert keys == ["a", "b", "c", "d", "escape", "right_square_bracket", "e"]


def test_escape_and_a_bracket_count_after_a_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    constants.TERMINAL_ANSWER_WITHIN.set(monkeypatch, 0.0)
    parser = KeyParser()
    assert list(parser.feed("\x1b]")) == []
    assert [event.key for event in parser.tick() if isinstance(event, Key)] == ["escape", "right_square_bracket"]


def test_escape_and_key_read_together_are_two() -> None:
    parser = KeyParser()
    keys = [event.key for event in parser.feed("\x1b/a\x1b\x1bj\x1b[A\x1bOP\x1b") if isinstance(event, Key)]
    assert keys == ["escape", "slash", "a", "escape", "escape", "j", "up", "f1"]
