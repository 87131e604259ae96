"""Sessions opened, written, imported and saved from the console: real files, and words for what is wrong with them."""

import os
from pathlib import Path

import msgspec
import pytest
from driving import NARROW, choose, drive, fill, gone, scripted_app, shown, text, until
from scripted import SESSION
from textual.events import Key
from textual.pilot import Pilot

from rsb_bridge.keys import fingerprint, read_key, write_key
from rsb_bridge.session import Session, Topic
from rsb_bridge.session_file import dump, load, save
from rsb_console.recents import LIMIT, recent_sessions, remember
from rsb_console.saving import moved, unsaved

BRINGUP = """\
client_node:
  ros__parameters:
    server_ip: '192.168.10.250'
    server_port: 3000
    transmit_topics: ['scan']
    transmit_msg_types: ['LaserScan']
    transmit_ports: [12004]
    transmit_protocols: ['{protocol}']
    transmit_qos: ['qos_profile_sensor_data']
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder."""
    path = tmp_path / "work"
    path.mkdir()
    monkeypatch.chdir(path)
    return path


def empty_app(**options):
    """The app without a session."""
    return scripted_app(session=None, path=None, **options)


async def shut(pilot: Pilot) -> None:
    """Wait until no dialog is open."""
    await until(pilot, lambda: pilot.app.screen is pilot.app.main, "the main screen")


# -- the beginning ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(120, 36), NARROW])
def test_without_a_session_the_console_says_how_to_begin(size: tuple[int, int]) -> None:
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "New session")
        for words in ("Demo", "Open a session", "Import", "Quit"):
            assert words in text(app)
        assert "…" not in text(app)
        await pilot.press("escape")
        await gone(pilot, "New session")
        await pilot.press("f5")
        await shown(pilot, "New session")

    drive(app, steps, size=size)


def test_a_dialog_that_is_left_leads_back_to_the_welcome() -> None:
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "Open a session")
        await pilot.press("down", "enter")
        await shown(pilot, "Session file")
        await pilot.press("escape")
        await shown(pilot, "Open a session")
        await pilot.press("q")
        await until(pilot, lambda: app.return_code is not None or not app.is_running, "the end")

    drive(app, steps)


def test_readonly_begins_with_what_writes_nothing() -> None:
    app = empty_app(readonly=True)

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "Open a session")
        assert "New session" not in text(app)
        assert "Import" not in text(app)
        await pilot.press("n", "i", "escape")  # there is nothing behind it to go to
        await pilot.pause()
        assert "Open a session" in text(app)

    drive(app, steps)


def test_a_recent_session_is_a_digit_away(folder: Path) -> None:
    save(SESSION, folder / "nav2.yaml")
    remember(folder / "nav2.yaml")
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "1  nav2")
        assert app.screen.menu.keys[-2:] == [str(folder / "nav2.yaml"), "quit"]
        await pilot.press("1")
        await until(pilot, lambda: app.engine is not None, "an engine")
        assert app.engine.session == SESSION
        assert app.engine.base == folder

    drive(app, steps)


# -- open ------------------------------------------------------------------------------------------------------------


def test_a_session_is_found_by_a_few_letters_and_opened(folder: Path) -> None:
    for name in ("alpha", "beta"):
        save(msgspec.structs.replace(SESSION, name=name), folder / f"{name}.yaml")
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "Open a session")
        await pilot.press("o", *"bet", "enter")
        await until(pilot, lambda: app.engine is not None, "an engine")
        assert app.engine.session.name == "beta"
        assert recent_sessions() == [folder / "beta.yaml"]

    drive(app, steps)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("name: robot1\nrole: cleint\n", "broken.yaml:2: role: 'cleint' is not one of client, server"),
        ("name: [\n", "broken.yaml:2:"),
        (None, "no such file"),
    ],
)
def test_a_session_that_does_not_load_says_why_with_the_line(folder: Path, content: str | None, words: str) -> None:
    if content is not None:
        (folder / "broken.yaml").write_text(content)
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "Open a session")
        await pilot.press("o")
        await shown(pilot, "Sessions")
        await fill(pilot, path=str(folder / "broken.yaml"))
        await pilot.press("enter")
        problem = app.screen.form.fields["path"].problem
        await until(pilot, lambda: words in str(problem.content), f"{words!r} beneath the path")
        assert app.engine is None

    drive(app, steps)


# -- new -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(120, 36), NARROW])
def test_a_new_session_is_a_valid_file_with_a_key_of_its_own(folder: Path, size: tuple[int, int]) -> None:
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "New session")
        await pilot.press("n")
        await shown(pilot, "Session file")
        await fill(pilot, name="robot1", server_ip="10.0.0.20", domain_id="3")
        await choose(pilot, "use_name", "yes")
        await shown(pilot, "will be made")
        await pilot.press("enter")
        await until(pilot, lambda: app.engine is not None, "an engine")

    drive(app, steps, size=size)
    expected = Session(
        name="robot1", role="client", server_ip="10.0.0.20", server_port=49152, domain_id=3, use_name=True,
        key_file="robot1.key",
    )  # fmt: skip
    assert load(folder / "robot1.yaml") == expected == app.engine.session
    assert (folder / "robot1.key").stat().st_mode & 0o777 == 0o600
    read_key(folder / "robot1.key")


def test_a_key_that_is_there_is_taken_and_known_by_its_fingerprint(folder: Path) -> None:
    key = write_key(folder / "shared.key")
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "New session")
        await pilot.press("n")
        await shown(pilot, "Session file")
        await choose(pilot, "role", "server")
        await fill(pilot, name="desk", server_ip="0.0.0.0", key_file="shared.key")
        await shown(pilot, f"is there, fingerprint {fingerprint(key)}")
        await pilot.press("enter")
        await until(pilot, lambda: app.engine is not None, "an engine")

    drive(app, steps)
    assert load(folder / "desk.yaml").key_file == "shared.key"
    assert read_key(folder / "shared.key") == key


MISTAKES = [
    ("name", "", "missing: give one"),
    ("server_ip", "10.0.0", "is not an IPv4"),
    ("server_ip", "0.0.0.0", "a client needs one"),
    ("server_port", "x", "'x' is not"),
    ("server_port", "0", "0 is not a port"),
    ("domain_id", "233", "0 to 232"),
    ("key_file", "nokey", "holds no key"),
    ("key_file", "nowhere/a.key", "there is no folder nowhere"),
    ("path", "nowhere/a.yaml", "there is no folder nowhere"),
    ("path", ".", "is a folder"),
]


def test_a_new_session_with_a_mistake_is_not_written(folder: Path) -> None:
    (folder / "nokey").write_text("nothing of the kind\n")
    right = {"name": "robot1", "server_ip": "10.0.0.20", "server_port": "49152"}
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "New session")
        await pilot.press("n")
        await shown(pilot, "Session file")
        await fill(pilot, **right)
        for key, typed, words in MISTAKES:
            field = app.screen.form.fields[key]
            await fill(pilot, **{key: typed})
            await pilot.press("enter")
            await until(pilot, lambda f=field, w=words: w in str(f.problem.content), f"{words!r} beneath {key}")
            assert field.problem.display
            await fill(pilot, **{key: right.get(key, "")})

    drive(app, steps)
    assert [path.name for path in folder.iterdir()] == ["nokey"]


@pytest.mark.parametrize(("key", "typed"), [("server_port", "3"), ("path", "robot.yaml3"), ("name", "3")])
def test_what_is_typed_on_coming_to_a_field_replaces_what_is_there_but_lengthens_a_path(key: str, typed: str) -> None:
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "New session")
        await pilot.press("n")
        await shown(pilot, "Session file")
        await fill(pilot, name="robot", path="robot.yaml")
        form = app.screen.form
        control = form.fields[key].control
        control.cursor_position = 1  # where it was left
        for each in (form.fields["role"].control, control):
            each.focus()
            await until(pilot, lambda e=each: e.has_focus, "the focus")
        assert control.selection.is_empty is (key == "path")
        await pilot.press("3")
        assert control.value == typed

    drive(app, steps)


def type_at_once(app, *keys: str) -> None:
    """Type faster than the console looks."""
    for key in keys:
        app._driver.send_message(Key(key, key if len(key) == 1 else None))


@pytest.mark.parametrize("pressed", ["server_port", "use_encryption", "#yes"])
def test_what_is_typed_between_create_and_its_refusal_lands_in_no_field(pressed: str) -> None:
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "New session")
        await pilot.press("n")
        await shown(pilot, "Session file")
        await fill(pilot, name="robot1", server_ip="10.0.0.20", domain_id="")
        form = app.screen.form
        control = form.fields[pressed].control if pressed in form.fields else app.screen.query_one(pressed)
        control.focus()
        await until(pilot, lambda: control.has_focus, "the focus")
        form.fields["domain_id"].value = "233"  # the refusal's reason
        before = form.values
        settle = form.settle

        def settle_and_type() -> bool:
            fine = settle()
            type_at_once(app, "y", "backspace")
            return fine

        listening_at: list[str] = []

        def listen() -> None:
            end()
            listening_at.append(text(app))

        end, form.typed_ahead.end = form.typed_ahead.end, listen
        form.settle = settle_and_type
        type_at_once(app, "enter", "x", "backspace", "h", "z")
        await shown(pilot, "0 to 232")
        await until(pilot, lambda: form.fields["domain_id"].control.has_focus, "the focus on what is wrong")
        assert form.values == before
        await until(pilot, lambda: listening_at, "a form that listens again")
        assert "0 to 232" in listening_at[0], "not before the refusal is to be seen"
        await fill(pilot, domain_id="3")
        await pilot.press("4")
        assert form.values["domain_id"] == "34"

    drive(app, steps)


def test_a_file_is_overwritten_only_with_a_yes(folder: Path) -> None:
    (folder / "robot1.yaml").write_text("# mine\n")
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "New session")
        await pilot.press("n")
        await shown(pilot, "Session file")
        await fill(pilot, name="robot1", server_ip="10.0.0.20")
        await pilot.press("enter")
        await shown(pilot, "Overwrite robot1.yaml?")
        await pilot.press("enter")  # the focus is on No
        await gone(pilot, "Overwrite robot1.yaml?")
        assert (folder / "robot1.yaml").read_text() == "# mine\n"
        await pilot.press("enter", "y")
        await until(pilot, lambda: app.engine is not None, "an engine")
        assert load(folder / "robot1.yaml").name == "robot1"

    drive(app, steps)


# -- import ----------------------------------------------------------------------------------------------------------


def test_a_thesis_file_becomes_a_session(folder: Path) -> None:
    (folder / "config").mkdir()
    (folder / "config" / "bringup.yaml").write_text(BRINGUP.format(protocol="UDP"))
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "Import")
        await pilot.press("i", *"bri", "enter")
        await until(pilot, lambda: app.screen.form.fields["name"].control.has_focus, "the next field")
        await fill(pilot, name="robot1", path="robot1.yaml", domain_id="x")
        await pilot.press("enter")
        await shown(pilot, "'x' is not a ROS domain")
        await fill(pilot, domain_id="7")
        await pilot.press("enter")
        await shown(pilot, "Imported. Run robot1.yaml?")
        await pilot.press("y")
        await until(pilot, lambda: app.engine is not None, "an engine")

    drive(app, steps)
    imported = load(folder / "robot1.yaml")
    expected = Topic("/scan", "transmit", "sensor_msgs/msg/LaserScan", "udp", 12004, "sensor_data")
    assert imported == app.engine.session
    assert imported.topics == (expected,)
    assert imported.domain_id == 7


@pytest.fixture
def robots(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Another folder than the working one, the user's home, with a thesis file."""
    path = folder.parent / "robots"
    path.mkdir()
    (path / "nav.yaml").write_text(BRINGUP.format(protocol="UDP"))
    monkeypatch.setenv("HOME", str(path))
    return path


@pytest.mark.parametrize("typed", ["{robots}/nav.yaml", "../robots/nav.yaml", "~/nav.yaml", "{robots}/nav.yaml  "])
def test_a_file_that_is_there_is_not_said_to_be_missing_and_names_the_session(robots: Path, typed: str) -> None:
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "Import")
        await pilot.press("i")
        await shown(pilot, "config/bringup.yaml")
        await fill(pilot, bringup=typed.format(robots=robots))
        await shown(pilot, "the file is there: ⏎ takes it")
        assert "no such file" not in text(app)
        await pilot.press("enter")
        form = app.screen.form
        await until(pilot, lambda: form.fields["name"].control.has_focus, "the next field")
        assert form.values["name"] == "nav"
        await fill(pilot, name="robot1")
        (robots / "map.yaml").touch()
        await fill(pilot, bringup=str(robots / "map.yaml"))
        assert form.values["name"] == "robot1", "a name that was given stays"
        await fill(pilot, path="robot1.yaml", bringup=typed.format(robots=robots))
        form.fields["name"].control.focus()
        await pilot.press("enter")
        await shown(pilot, "Imported. Run robot1.yaml?")

    drive(app, steps)


@pytest.mark.parametrize("typed", ["nowhere/a.yaml", "~nobody_is_called_so/a", f"{'long' * 100}.yaml"], ids=len)
@pytest.mark.parametrize(("key", "field"), [("i", "bringup"), ("o", "path"), ("n", "path"), ("n", "key_file")])
def test_a_path_to_nowhere_is_said_to_be_one(robots: Path, typed: str, key: str, field: str) -> None:
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "Open a session")
        await pilot.press(key)
        await until(pilot, lambda: hasattr(app.screen, "form"), "a form")
        if key == "n":
            await fill(pilot, name="robot1", **{field: typed})
        else:
            await fill(pilot, **{field: typed})
            await shown(pilot, "no such file")
        await pilot.press("enter")
        problem = app.screen.form.fields[field].problem
        await until(pilot, lambda: problem.display or key == "i", "what is wrong")

    drive(app, steps)


def test_a_thesis_file_with_a_mistake_says_the_line(folder: Path) -> None:
    (folder / "bringup.yaml").write_text(BRINGUP.format(protocol="UDX"))
    app = empty_app()

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "Import")
        await pilot.press("i", *"bri", "enter")
        await fill(pilot, name="robot1", path="robot1.yaml")
        await pilot.press("enter")
        await shown(pilot, "line 8:")
        await shown(pilot, "(did you mean udp?)")
        assert not (folder / "robot1.yaml").exists()

    drive(app, steps)


# -- save ------------------------------------------------------------------------------------------------------------


def changed(app, *topics: Topic) -> Session:
    """As if operators had changed the session's topics."""
    app.engine.session = msgspec.structs.replace(app.engine.session, topics=topics)
    return app.engine.session


def test_saving_asks_and_then_the_file_holds_what_runs(folder: Path) -> None:
    path = folder / "nav2.yaml"
    save(SESSION, path)
    app = scripted_app(path=path)

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "/robot2/scan")
        now = changed(app, Topic("/new", "transmit"))
        await pilot.press("w")
        await shown(pilot, "Overwrite nav2.yaml?")
        await pilot.press("n")
        await shut(pilot)
        assert load(path) == SESSION
        await pilot.press("w", "y")
        await shown(pilot, "saved:")
        assert load(path) == now

    drive(app, steps)


def test_what_would_be_saved_as_it_is_leaves_the_file_with_its_comments(folder: Path) -> None:
    path = folder / "nav2.yaml"
    path.write_text(f"# mine\n{dump(SESSION)}")
    app = scripted_app(path=path)

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "/robot2/scan")
        await pilot.press("w")
        await shown(pilot, "nothing has changed:")
        assert "no topics" not in text(app), "a client's session holds them"
        assert path.read_text().startswith("# mine")
        path.write_text("name: [\n")  # somebody broke it meanwhile
        await pilot.press("w")
        await shown(pilot, "Overwrite nav2.yaml?")

    drive(app, steps)


async def save_as(pilot: Pilot, path: str) -> None:
    """Save the session to another file."""
    await pilot.press("W")
    await shown(pilot, "Save as")
    await fill(pilot, path=path)
    await pilot.press("enter")


def test_saving_a_server_says_that_the_topics_are_not_in_it(folder: Path) -> None:
    session = msgspec.structs.replace(SESSION, role="server")
    save(session, folder / "pc.yaml")
    app = scripted_app(session=session, path=folder / "pc.yaml")

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "/robot2/scan")
        await pilot.press("w")
        await shown(pilot, "nothing has changed:")
        await shown(pilot, "no topics")
        await save_as(pilot, "other.yaml")
        await shown(pilot, "saved: other.yaml")
        assert load(folder / "other.yaml") == session

    drive(app, steps)


def test_saved_to_another_folder_the_key_is_still_found(folder: Path) -> None:
    (folder / "robots").mkdir()
    (folder / "safe").mkdir()
    key = write_key(folder / "safe" / "r.key")
    session = msgspec.structs.replace(SESSION, key_file="safe/r.key")
    save(session, folder / "nav2.yaml")
    app = scripted_app(session=session, path=folder / "nav2.yaml")

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "/robot2/scan")
        await save_as(pilot, str(folder / "robots" / "r.yaml"))
        await until(pilot, lambda: app.path == folder / "robots" / "r.yaml", "another file")
        await pilot.press("w")  # once more, over itself
        await shown(pilot, "nothing has changed:")

    drive(app, steps)
    saved = load(folder / "robots" / "r.yaml")
    assert saved.key_file == os.path.join("..", "safe", "r.key")  # noqa: PTH118 -- as it stands in the file
    assert read_key(folder / "robots" / saved.key_file) == key


def test_what_ends_with_the_console_is_saved_with_its_key(folder: Path) -> None:
    old = folder / "ends"
    old.mkdir()
    key, other = write_key(old / "demo.key"), write_key(folder / "demo.key")
    session = msgspec.structs.replace(SESSION, key_file="demo.key")
    save(session, old / "demo.yaml")
    app = scripted_app(session=session, path=old / "demo.yaml", temporary=True)

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "/robot2/scan")
        await save_as(pilot, "kept.yaml")
        await shown(pilot, "with its key: ")
        await pilot.press("w")
        await shown(pilot, "nothing has changed:")
        changed(app, Topic("/new", "transmit"))
        await pilot.press("w", "y")
        await until(pilot, lambda: load(folder / "kept.yaml").topics, "the topic")

    drive(app, steps)
    kept = load(folder / "kept.yaml")
    assert kept.key_file == "demo-2.key"
    assert read_key(folder / "demo-2.key") == key
    assert (folder / "demo-2.key").stat().st_mode & 0o777 == 0o600
    assert read_key(folder / "demo.key") == other, "another's stays"
    assert not (folder / "demo-3.key").exists()


def test_a_key_that_cannot_be_saved_is_told(folder: Path) -> None:
    session = msgspec.structs.replace(SESSION, key_file="gone.key")
    app = scripted_app(session=session, path=folder / "demo.yaml", temporary=True)

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "/robot2/scan")
        await save_as(pilot, "kept.yaml")
        await shown(pilot, "The key is not saved")
        assert not (folder / "kept.yaml").exists()

    drive(app, steps)


def test_what_cannot_be_saved_is_said(folder: Path) -> None:
    path = folder / "nav2.yaml"
    app = scripted_app(path=path)

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "/robot2/scan")
        changed(app, Topic("/a", "transmit"), Topic("/a", "transmit"))
        await pilot.press("w")
        await shown(pilot, "Not saved")
        assert not path.exists()

    drive(app, steps)


def test_quitting_names_what_is_not_saved(folder: Path) -> None:
    save(SESSION, folder / "nav2.yaml")
    app = scripted_app(path=folder / "nav2.yaml")

    async def steps(pilot: Pilot) -> None:
        await shown(pilot, "/robot2/scan")
        changed(app, Topic("/new", "transmit"))
        await pilot.press("q")
        await shown(pilot, "Not saved (w saves): added /new.")
        await pilot.press("enter")
        await shut(pilot)
        assert app.is_running

    drive(app, steps)


def test_differences_in_words() -> None:
    one, other = Topic("/a", "transmit"), Topic("/b", "receive")
    saved = msgspec.structs.replace(SESSION, topics=(one, other))
    louder = msgspec.structs.replace(other, max_rate=5.0)
    now = msgspec.structs.replace(SESSION, topics=(Topic("/c", "receive"), louder))
    assert unsaved(saved, now) == "added /c; removed /a; changed /b"
    assert unsaved(saved, msgspec.structs.replace(SESSION, topics=(other, one))) == ""


def test_an_absolute_key_file_stays_as_it_is(folder: Path) -> None:
    session = msgspec.structs.replace(SESSION, key_file="/etc/rsb/r.key")
    assert moved(session, folder, folder.parent) == session


# -- recents ---------------------------------------------------------------------------------------------------------


def test_recent_sessions_are_few_newest_first_and_there(folder: Path) -> None:
    assert recent_sessions() == []
    paths = [folder / f"{number}.yaml" for number in range(LIMIT + 5)]
    for path in paths:
        path.touch()
        remember(path)
    remember(paths[-3])
    paths[-1].unlink()
    recent = recent_sessions()
    assert recent[:2] == [paths[-3], paths[-2]]
    assert len(recent) == LIMIT - 1
