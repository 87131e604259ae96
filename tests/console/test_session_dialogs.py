"""Sessions opened and written from the console: real files, and words for what is wrong with them."""

from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.console.driving import NARROW, choose, engine_of, fill, form_of, gone, notices, on_welcome, shown, until
from tests.console.scripted import SESSION
from tests.support.long import long
from textual.pilot import Pilot

from rsb_bridge.config.keys import fingerprint, read_key, write_key
from rsb_bridge.config.session_file import load, save
from rsb_bridge.model.session import Session
from rsb_console.app import ConsoleApp
from rsb_console.screens.new_session import MissingField
from rsb_console.screens.welcome_screen import WelcomeScreen
from rsb_console.session.recent_sessions import recent_sessions, remember
from rsb_console.session.saving import PathProblem

pytestmark = pytest.mark.usefixtures("folder")


# -- the beginning ---------------------------------------------------------------------------------------------------


@on_welcome(*long((120, 36)), NARROW)
async def test_without_session_console_says_how_to_begin(app: ConsoleApp, pilot: Pilot[None]) -> None:
    for words in ("Demo", "Open a session", "Import", "Quit"):
        await shown(pilot, words)
    await gone(pilot, "…")
    await pilot.press("escape")
    await gone(pilot, "New session")
    await pilot.press("f5")
    await shown(pilot, "New session")


@on_welcome()
async def test_dialog_that_is_left_leads_back_to_welcome(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("down", "enter")
    await shown(pilot, "Session file")
    await pilot.press("escape")
    await shown(pilot, "Open a session")
    await pilot.press("q")
    await until(pilot, lambda: app.return_code is not None or not app.is_running, "the end")


@on_welcome(landmark="Open a session", readonly=True)
async def test_readonly_begins_with_what_writes_nothing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await gone(pilot, "New session")
    await gone(pilot, "Import")
    await pilot.press("n", "i", "escape")  # no screen is behind it
    await pilot.pause()
    await shown(pilot, "Open a session")


def remembered() -> dict[str, Any]:
    """A session that was opened before."""
    save(SESSION, Path("nav2.yaml"))
    remember(Path("nav2.yaml").resolve())
    return {}


@on_welcome(landmark="1  nav2", before=remembered)
async def test_digit_chooses_recent_session_and_enter_starts_it(
    app: ConsoleApp, pilot: Pilot[None], folder: Path
) -> None:
    assert isinstance(app.screen, WelcomeScreen)
    assert app.screen.menu.keys[-2:] == [str(folder / "nav2.yaml"), "quit"]
    await pilot.press("5")
    await until(pilot, lambda: notices(app), "a notice: there is no fifth")
    await pilot.press("1")
    assert app.screen.menu.cursor_key == str(folder / "nav2.yaml")
    await pilot.pause(0.1)
    assert app.engine is None
    await pilot.press("enter")
    await until(pilot, lambda: app.engine is not None, "an engine")
    assert engine_of(app).session == SESSION
    assert engine_of(app).base == folder


# -- open ------------------------------------------------------------------------------------------------------------


@on_welcome(landmark="Open a session")
async def test_session_is_found_by_few_letters_and_opened(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    for name in ("alpha", "beta"):
        save(msgspec.structs.replace(SESSION, name=name), folder / f"{name}.yaml")
    await pilot.press("o", *"bet", "enter")
    await until(pilot, lambda: app.engine is not None, "an engine")
    assert engine_of(app).session.name == "beta"
    assert recent_sessions() == [folder / "beta.yaml"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("name: robot1\nrole: cleint\n", "broken.yaml:2: role: 'cleint' is not one of client, server"),
        ("name: [\n", "broken.yaml:1:"),
        (None, "no such file"),
    ],
)
@on_welcome()
async def test_session_that_does_not_load_names_line(
    app: ConsoleApp, pilot: Pilot[None], folder: Path, content: str | None, words: str
) -> None:
    if content is not None:
        (folder / "broken.yaml").write_text(content)
    await pilot.press("o")
    await shown(pilot, "Sessions")
    await fill(pilot, path=str(folder / "broken.yaml"))
    await pilot.press("enter")
    problem = form_of(app).fields["path"].problem
    await until(pilot, lambda: words in str(problem.content), f"{words!r} beneath the path")
    assert app.engine is None


# -- new -------------------------------------------------------------------------------------------------------------


@on_welcome(*long((120, 36)), NARROW)
async def test_new_session_is_valid_with_own_key(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    await pilot.press("n")
    await shown(pilot, "Session file")
    await fill(pilot, name="robot1", server_ip="10.0.0.20, vpn.local", domain_id="3")
    await choose(pilot, "use_name", "yes")
    await shown(pilot, "will be created")
    await pilot.press("enter")
    await until(pilot, lambda: app.engine is not None, "an engine")
    expected = Session(
        name="robot1", role="client", server_ip=("10.0.0.20", "vpn.local"), server_port=7060, domain_id=3,
        use_name=True, key_file="robot1.key",
    )  # fmt: skip
    assert load(folder / "robot1.yaml") == expected == engine_of(app).session
    assert (folder / "robot1.key").stat().st_mode & 0o777 == 0o600
    read_key(folder / "robot1.key")


@on_welcome()
async def test_existing_key_is_taken_and_known_by_fingerprint(
    app: ConsoleApp, pilot: Pilot[None], folder: Path
) -> None:
    key = write_key(folder / "shared.key")
    await pilot.press("n")
    await shown(pilot, "Session file")
    await choose(pilot, "role", "server")
    await fill(pilot, name="desk", server_ip="0.0.0.0", key_file="shared.key")
    await shown(pilot, f"exists, fingerprint {fingerprint(key)}")
    await pilot.press("enter")
    await until(pilot, lambda: app.engine is not None, "an engine")
    assert load(folder / "desk.yaml").key_file == "shared.key"
    assert read_key(folder / "shared.key") == key


MISTAKES = [
    ("name", "", "missing: give one"),
    ("server_ip", "10.0.0", "is not an IPv4"),
    ("server_ip", "0.0.0.0", "a client cannot connect to 0.0.0.0"),
    ("server_ip", "10.0.0.1, fe80::1", "fe80::1 is link-local"),
    ("server_port", "", MissingField.PORT()),
    ("server_port", "x", "'x' is not"),
    ("server_port", "0", "missing, or 0: give a port"),
    ("domain_id", "233", "0 to 232"),
    ("key_file", "nokey", "holds no key"),
    ("key_file", "nowhere/a.key", PathProblem.NO_FOLDER(folder="nowhere")),
    ("path", "nowhere/a.yaml", PathProblem.NO_FOLDER(folder="nowhere")),
    ("path", ".", "is a folder"),
]


@on_welcome()
async def test_new_session_with_mistake_is_not_written(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    (folder / "nokey").write_text("nothing of the kind\n")
    right = {"name": "robot1", "server_ip": "10.0.0.20", "server_port": "49152"}
    await pilot.press("n")
    await shown(pilot, "Session file")
    await fill(pilot, **right)
    for key, typed, words in MISTAKES:
        field = form_of(app).fields[key]
        await fill(pilot, **{key: typed})
        await pilot.press("enter")
        await until(pilot, lambda f=field, w=words: w in str(f.problem.content), f"{words!r} beneath {key}")
        assert field.problem.display
        await fill(pilot, **{key: right.get(key, "")})
    assert [path.name for path in folder.iterdir()] == ["nokey"]


@on_welcome()
async def test_a_file_is_overwritten_only_with_a_yes(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    (folder / "robot1.yaml").write_text("# mine\n")
    await pilot.press("n")
    await shown(pilot, "Session file")
    await fill(pilot, name="robot1", server_ip="10.0.0.20")
    await pilot.press("enter")
    await shown(pilot, "Overwrite robot1.yaml?")
    await pilot.press("enter")  # the focus is on No
    await gone(pilot, "Overwrite robot1.yaml?")
    assert (folder / "robot1.yaml").read_text() == "# mine\n"
    await pilot.press("enter")
    await shown(pilot, "-# mine")
    (folder / "robot1.yaml").write_text("# theirs\n")
    await pilot.press("y")
    await shown(pilot, "-# theirs")
    await pilot.press("y")
    await until(pilot, lambda: app.engine is not None, "an engine")
    assert load(folder / "robot1.yaml").name == "robot1"


@on_welcome()
async def test_path_to_nowhere_is_said_to_be_one(app: ConsoleApp, pilot: Pilot[None]) -> None:
    for key, fields in (("o", ("path",)), ("n", ("path", "key_file"))):
        for typed in ("nowhere/a.yaml", "~nobody_is_called_so/a", f"{'long' * 100}.yaml"):
            await shown(pilot, "Open a session")
            await pilot.press(key)
            await until(pilot, lambda: hasattr(app.screen, "form"), "a form")
            await fill(pilot, **({"name": "robot1"} if key == "n" else {}), **dict.fromkeys(fields, typed))
            await pilot.press("enter")
            problems = [form_of(app).fields[each].problem for each in fields]
            await until(pilot, lambda shown=problems: all(each.display for each in shown), "what is wrong")
            await pilot.press("escape")
            await until(pilot, lambda: not hasattr(app.screen, "form"), "the form gone")
