"""Sessions saved from the console, over their files and elsewhere; and the list of the recent ones."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.console.driving import NARROW, WIDE, Decorator, engine_of, fill, gone, notices, on_main, shown, text, until
from tests.console.scripted import LINK, SESSION
from textual.pilot import Pilot

from rsb_bridge.config.files import replace_file
from rsb_bridge.config.keys import read_key, write_key
from rsb_bridge.config.session_file import dump, load, save
from rsb_bridge.model.session import Client, Session, Topic
from rsb_console.app import ConsoleApp
from rsb_console.operations.bridge_operations import ReloadText
from rsb_console.operations.save_operations import SaveQuestion
from rsb_console.operations.session_operations import SessionQuestion
from rsb_console.screens.save_screens import SaveText
from rsb_console.session.recent_sessions import LIMIT, recent_sessions, remember
from rsb_console.session.saving import moved, unsaved

pytestmark = pytest.mark.usefixtures("folder")


COMMENTED = f"# mine\n{dump(SESSION)}topics:\n- {{ topic: /a, direction: transmit }}   # ours\n# not yet: /b\n"
LONG = f"{dump(SESSION)}topics:\n" + "".join(f"- {{topic: /a{at}, direction: transmit}}\n" for at in range(40))
UNUSUAL = f"# mine\n{dump(SESSION)}? topics\n: - {{topic: /a, direction: transmit}}\n"
SERVER = msgspec.structs.replace(SESSION, role="server")
ONE_TOPIC = msgspec.structs.replace(SESSION, topics=(Topic("/a", "transmit"),))


def on_file(text: str = dump(SESSION), *sizes: Any) -> Decorator:
    """A test's steps run on the session of a file, and get its path."""

    def written() -> dict[str, Any]:
        path = Path("nav2.yaml").resolve()
        path.write_text(text)
        return {"path": path, "session": load(path)}

    async def opened(pilot: Pilot[None]) -> dict[str, Any]:
        return {"path": Path("nav2.yaml").resolve()}

    return on_main(*sizes, before=written, opening=opened, makes=("path",))


async def shut(pilot: Pilot[None]) -> None:
    """Wait until no dialog is open."""
    app = pilot.app
    assert isinstance(app, ConsoleApp)
    await until(pilot, lambda: app.screen is app.main, "the main screen")


def changed(app: ConsoleApp, *topics: Topic) -> Session:
    """Change the session's topics as operators do."""
    engine_of(app).session = msgspec.structs.replace(engine_of(app).session, topics=topics)
    return engine_of(app).session


async def saves_nothing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Press the key, and wait for the notice."""
    app.clear_notifications()
    await pilot.press("w")
    await until(pilot, lambda: any("nothing to save:" in each.message for each in notices(app)), "the notice")


@on_file()
async def test_saving_asks_and_then_file_holds_what_runs(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    now = changed(app, Topic("/new", "transmit"))
    await pilot.press("w")
    await shown(pilot, "Save nav2.yaml?")
    await pilot.press("n")
    await shut(pilot)
    assert load(path) == SESSION
    await pilot.press("w", "y")
    await shown(pilot, "saved:")
    assert load(path) == now


@on_file(dump(SESSION), WIDE, NARROW)
async def test_unsaved_changes_are_in_header_and_footer(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    await gone(pilot, "unsaved")
    changed(app, Topic("/new", "transmit"))
    await shown(pilot, "● unsaved")
    await shown(pilot, " w save ")
    await pilot.press("w", "y")
    await until(pilot, lambda: "unsaved" not in text(app) and " w save " not in text(app), "saved")


@on_file(dump(SESSION), WIDE, NARROW)
async def test_change_of_other_side_s_session_is_saved_there(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    """`w` writes no file here, and says where."""
    before = path.read_text()
    engine = engine_of(app)
    engine.now = replace(engine.now, links=(replace(LINK, unsaved_there=True),))
    await shown(pilot, "● unsaved on the server")
    await pilot.press("w")
    said = SaveQuestion.ONLY_THERE(name="the server")
    await until(pilot, lambda: any(said in each.message for each in notices(app)), "where it is saved")
    assert path.read_text() == before


@on_file(f"# mine\n{dump(SESSION)}")
async def test_unchanged_session_leaves_file_with_comments(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    await saves_nothing(app, pilot)
    assert path.read_text().startswith("# mine")


@on_file(COMMENTED)
async def test_comments_and_layout_survive_a_save(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    changed(app, Topic("/a", "transmit", protocol="udp"), Topic("/new", "transmit"))
    await pilot.press("w")
    await shown(pilot, "added /new; changed /a")
    await pilot.press("y")
    await shown(pilot, "saved:")
    changed(app, Topic("/a", "transmit", protocol="udp"))
    await pilot.press("w", "y")
    await until(pilot, lambda: "/new" not in path.read_text(), "the second save")
    assert path.read_text() == COMMENTED.replace("transmit }", "transmit, protocol: udp }")


@pytest.mark.parametrize("edited", ["name: [\n", "# mine, later\n{}stale_after: 3.0\n"])
@on_file()
async def test_concurrent_change_on_disk_is_not_overwritten(
    app: ConsoleApp, pilot: Pilot[None], path: Path, edited: str
) -> None:
    edited = edited.format(dump(SESSION))
    changed(app, Topic("/new", "transmit"))
    path.write_text(edited)
    await pilot.press("w")
    await shown(pilot, SaveText.CHANGED_ON_DISK, file="nav2.yaml")
    await pilot.press("enter")  # the focus is on Cancel
    await shut(pilot)
    assert path.read_text() == edited
    await pilot.press("w")
    await shown(pilot, SaveText.CHANGED_ON_DISK, file="nav2.yaml")
    await pilot.click("#save_as")
    await shown(pilot, "Save as")
    await fill(pilot, path="other.yaml")
    await pilot.press("enter")
    await shown(pilot, "saved: other.yaml")
    assert path.read_text() == edited
    assert load(path.with_name("other.yaml")).topics == (Topic("/new", "transmit"),)


@pytest.mark.parametrize("how", ["touched", "written anew", "commented"])
@on_file()
async def test_file_with_same_content_was_changed_by_nobody(
    app: ConsoleApp, pilot: Pilot[None], path: Path, how: str
) -> None:
    text_now = path.read_text() if how != "commented" else f"# mine, later\n{path.read_text()}"
    now = changed(app, Topic("/new", "transmit"))
    if how == "touched":
        os.utime(path, (1.0, 1.0))
    else:
        replace_file(path, text_now.encode(), like=path)
    await pilot.press("w")
    await shown(pilot, "Changes: added /new.")
    await pilot.press("y")
    await shown(pilot, "saved:")
    assert load(path) == now
    assert path.read_text().startswith(text_now.splitlines()[0])


@on_file()
async def test_file_changed_on_disk_is_overwritten_with_comments(
    app: ConsoleApp, pilot: Pilot[None], path: Path
) -> None:
    edited = f"# mine, later\n{dump(SESSION)}stale_after: 3.0\n"
    now = changed(app, Topic("/new", "transmit"))
    path.write_text(edited)
    await pilot.press("w")
    await shown(pilot, SaveText.CHANGED_ON_DISK, file="nav2.yaml")
    await pilot.click("#overwrite")
    await shown(pilot, "Changes: added /new; changed stale_after.")
    await shown(pilot, "-stale_after: 3.0")
    await pilot.press("y")
    await shown(pilot, "saved:")
    assert path.read_text().startswith("# mine, later\n")
    assert load(path) == now
    assert path.with_name("nav2.yaml~").read_text() == edited


@on_file()
async def test_file_changed_on_disk_can_be_reloaded(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    later = msgspec.structs.replace(SESSION, stale_after=3.0)
    changed(app, Topic("/new", "transmit"))
    save(later, path)
    await pilot.press("w")
    await shown(pilot, SaveText.CHANGED_ON_DISK, file="nav2.yaml")
    await pilot.click("#reload")
    await shown(pilot, ReloadText.RELOAD)
    await pilot.press("y")
    await shown(pilot, "reloaded")
    assert engine_of(app).commands == [("reload", True, "drop_arm"), ("reload", False, "drop_arm")]
    assert load(path) == later


@on_file()
async def test_quitting_ignores_what_somebody_else_has_saved(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    save(changed(app, Topic("/new", "transmit")), path)
    await pilot.press("q")
    await shown(pilot, "Quit?")
    await gone(pilot, "Not saved")


@on_file(LONG, NARROW)
async def test_the_difference_is_shown_before_it_is_written(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    first, *rest = load(path).topics
    changed(app, msgspec.structs.replace(first, max_rate=5.0), *rest[20:])
    await pilot.press("w")
    await shown(pilot, "-- {topic: /a0, direction: transmit}")
    await gone(pilot, "/a20, direction")
    await pilot.press("pagedown", "pagedown")
    await shown(pilot, "-- {topic: /a20, direction: transmit}")
    await shown(pilot, "+- {topic: /a0, direction: transmit, max_rate: 5}")
    await shown(pilot, "Save        No")
    assert "max_rate" not in path.read_text()


@on_file(dump(ONE_TOPIC), NARROW)
async def test_long_line_of_difference_is_shown_whole(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    changed(app, Topic("/a", "transmit", type="sensor_msgs/msg/LaserScan", protocol="udp", max_rate=12.5))
    await pilot.press("w")
    await shown(pilot, "Save nav2.yaml?")
    await shown(pilot, "max_rate: 12.5}")


@on_file(UNUSUAL)
async def test_uneditable_layout_is_rewritten_only_after_question(
    app: ConsoleApp, pilot: Pilot[None], path: Path
) -> None:
    now = changed(app, Topic("/new", "transmit"))
    await pilot.press("w")
    await shown(pilot, SaveText.REWRITE, file="nav2.yaml")
    await shown(pilot, SaveText.REWRITTEN)
    await pilot.press("n")
    await shut(pilot)
    assert path.read_text() == UNUSUAL
    await pilot.press("w")
    await shown(pilot, SaveText.REWRITE, file="nav2.yaml")
    await pilot.press("y")
    await shown(pilot, "saved:")
    assert load(path) == now
    assert path.with_name("nav2.yaml~").read_text() == UNUSUAL


async def save_as(pilot: Pilot[None], path: str) -> None:
    await pilot.press("W")
    await shown(pilot, "Save as")
    await fill(pilot, path=path)
    await pilot.press("enter")


@on_file(f"# mine\n{dump(SERVER)}")
async def test_server_saves_what_operators_added_under_its_client(
    app: ConsoleApp, pilot: Pilot[None], path: Path
) -> None:
    await saves_nothing(app, pilot)
    now = msgspec.structs.replace(SERVER, clients=(Client("robot1", topics=(Topic("/new", "transmit"),)),))
    engine_of(app).session = now
    await pilot.press("w")
    await shown(pilot, "Changes: added /new for robot1.")
    await pilot.press("y")
    await shown(pilot, "saved:")
    assert load(path) == now
    assert path.read_text().startswith("# mine\n")


def at(path: str, **options: Any) -> Decorator:
    """A test's steps run on a session that was read from there."""
    return on_main(before=lambda: {"path": Path(path).resolve()}, **options)


KEY_ELSEWHERE = msgspec.structs.replace(SESSION, key_file="safe/r.key")


@at("nav2.yaml", session=KEY_ELSEWHERE)
async def test_saved_to_another_folder_key_is_still_found(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    (folder / "robots").mkdir()
    (folder / "safe").mkdir()
    key = write_key(folder / "safe" / "r.key")
    save(KEY_ELSEWHERE, folder / "nav2.yaml")
    await save_as(pilot, str(folder / "robots" / "r.yaml"))
    await until(pilot, lambda: app.path == folder / "robots" / "r.yaml", "another file")
    await saves_nothing(app, pilot)  # once more, over itself
    saved = load(folder / "robots" / "r.yaml")
    assert saved.key_file == os.path.join("..", "safe", "r.key")  # noqa: PTH118 -- as the file has it
    assert read_key(folder / "robots" / saved.key_file) == key


DEMO = msgspec.structs.replace(SESSION, key_file="demo.key")


@at("ends/demo.yaml", session=DEMO, temporary=True)
async def test_what_ends_with_console_is_saved_by_key(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    old = folder / "ends"
    old.mkdir()
    key, other = write_key(old / "demo.key"), write_key(folder / "demo.key")
    save(DEMO, old / "demo.yaml")
    await save_as(pilot, "kept.yaml")
    await shown(pilot, SaveText.KEY_SAVED)
    await saves_nothing(app, pilot)
    changed(app, Topic("/new", "transmit"))
    await pilot.press("w", "y")
    await until(pilot, lambda: load(folder / "kept.yaml").topics, "the topic")
    kept = load(folder / "kept.yaml")
    assert kept.key_file == "demo-2.key"
    assert read_key(folder / "demo-2.key") == key
    assert (folder / "demo-2.key").stat().st_mode & 0o777 == 0o600
    assert read_key(folder / "demo.key") == other, "another's stays"
    assert not (folder / "demo-3.key").exists()


@at("demo.yaml", session=DEMO, temporary=True)
async def test_a_key_that_cannot_be_saved_is_told(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    await save_as(pilot, "kept.yaml")
    await shown(pilot, SaveText.KEY_NOT_SAVED)
    assert not (folder / "kept.yaml").exists()


@at("nav2.yaml")
async def test_what_cannot_be_saved_is_said(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    changed(app, Topic("/a", "transmit"), Topic("/a", "transmit"))
    await pilot.press("w")
    await shown(pilot, "Not saved")
    assert not (folder / "nav2.yaml").exists()


@on_file()
async def test_quitting_names_what_is_not_saved(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    changed(app, Topic("/new", "transmit"))
    await pilot.press("q")
    await shown(pilot, SessionQuestion.NOT_SAVED, changes="added /new")
    changed(app, Topic("/new", "transmit"), Topic("/newer", "transmit"))
    await pilot.press("y")
    await shown(pilot, SessionQuestion.NOT_SAVED, changes="added /new, /newer")  # others may go on meanwhile
    await pilot.press("enter")
    await shut(pilot)
    assert app.is_running


def test_differences_in_words() -> None:
    one, other = Topic("/a", "transmit"), Topic("/b", "receive")
    saved = msgspec.structs.replace(SESSION, topics=(one, other))
    louder = msgspec.structs.replace(other, max_rate=5.0)
    now = msgspec.structs.replace(SESSION, topics=(Topic("/c", "receive"), louder))
    assert unsaved(saved, now) == "added /c; removed /a; changed /b"
    assert unsaved(saved, msgspec.structs.replace(SESSION, topics=(other, one))) == ""


def test_differences_of_servers_in_words() -> None:
    alone = Client(SESSION.name)
    assert unsaved(SERVER, msgspec.structs.replace(SERVER, clients=(alone,))) == ""
    robots = (Client("robot1", deny=("/a",)), Client("robot2", topics=(Topic("/b", "receive"),)))
    now = msgspec.structs.replace(SERVER, clients=robots, server_port=1234)
    assert unsaved(SERVER, now) == "added client robot2, /b for robot2; changed server_port, client robot1"


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
