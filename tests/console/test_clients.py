"""A server's clients in the console: added and removed while it runs, and made with a new session."""

import functools
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from tests.console.driving import (
    NARROW,
    choose,
    engine_of,
    fill,
    form_of,
    gone,
    notified,
    on_main,
    on_welcome,
    shown,
    shown_at_the_end,
)
from tests.console.scripted import SESSION
from tests.support.long import long
from textual.pilot import Pilot

from rsb_bridge.config.keys import fingerprint, read_key, write_key
from rsb_bridge.config.session_file import SavingProblem, load, save
from rsb_bridge.model.session import Client, Session, Topic
from rsb_console.app import ConsoleApp
from rsb_console.screens.clients_screen import ClientText
from rsb_console.screens.links_screen import CLIENT_KEYS
from rsb_console.screens.new_session import HANDOUT

pytestmark = pytest.mark.usefixtures("folder")
ROBOT1, ROBOT2 = Client("robot1", "robot1.key"), Client("robot2", "robot2.key", deny=("/raw",))
SERVER = replace(SESSION, name="pc", role="server", key_file=None, clients=(ROBOT1, ROBOT2))


def server_file() -> dict[str, Any]:
    """Write a server's session, and a key."""
    path = Path("pc.yaml").resolve()
    save(SERVER, path)
    path.write_text(f"# the fleet\n{path.read_text()}")
    write_key(path.with_name("robot1.key"))
    return {"session": load(path), "path": path}


async def links(pilot: Pilot[None]) -> dict[str, Any]:
    """Open the links; a test's steps get the session file."""
    await pilot.press("c")
    await shown(pilot, CLIENT_KEYS)
    assert isinstance(pilot.app, ConsoleApp)
    return {"path": pilot.app.path}


on_links = functools.partial(on_main, opening=links, makes=("path",), before=server_file)
"""A test's steps run with the links of a server's session open; they get its file."""


async def robot3_added(pilot: Pilot[None]) -> None:
    await pilot.press("a")
    await shown(pilot, "Add a client")
    await fill(pilot, name="robot3")
    await pilot.press("enter")


async def back_on_main(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    """Close the links of a bridge that has the file's session."""
    engine_of(app).session = load(path)
    await pilot.press("escape")
    await gone(pilot, CLIENT_KEYS)


@on_links(*long((120, 36)), NARROW)
async def test_client_is_added_and_removed_in_file_too(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    await pilot.press("a")
    await shown(pilot, "Add a client")
    await fill(pilot, name="robot1")
    await shown(pilot, ClientText.EXISTS)
    await fill(pilot, name="robot3", deny="/camera/*, raw")
    await shown(pilot, "'raw' matches no topic")
    await fill(pilot, deny="/camera/* /raw")
    await pilot.press("enter")
    await shown(pilot, "robot3 is added")
    await shown(pilot, "name: robot3")
    key = read_key(path.with_name("robot3.key"))
    for group in fingerprint(key).split():  # the line breaks wherever the path before it leaves it no room
        await shown_at_the_end(pilot, group, "end")
    added = Client("robot3", "robot3.key", deny=("/camera/*", "/raw"))
    assert engine_of(app).commands == [("add client", added)]
    assert load(path).clients == (ROBOT1, ROBOT2, added)
    await pilot.press("escape")
    await gone(pilot, "robot3 is added")
    assert app.saved == load(path), "nothing is left to save"
    assert path.read_text().startswith("# the fleet\n")
    await back_on_main(app, pilot, path)
    await pilot.press("u")
    await shown(pilot, "remove the client robot3?")
    await pilot.press("y")
    await gone(pilot, "remove the client robot3?")
    assert engine_of(app).commands[1:] == [("remove client", "robot3")]
    assert load(path).clients == SERVER.clients
    assert path.with_name("robot3.key").exists()


@on_links()
async def test_client_is_removed_with_yes_and_returns(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    key = read_key(path.with_name("robot1.key"))
    await pilot.press("d")
    await shown(pilot, "Remove the client robot1?")
    await pilot.press("enter")  # the focus is on No
    await gone(pilot, "Remove the client robot1?")
    assert engine_of(app).commands == []
    await pilot.press("d", "y")
    await shown(pilot, "robot1: removed")
    assert load(path).clients == (ROBOT2,)
    await back_on_main(app, pilot, path)
    await pilot.press("u")
    await shown(pilot, ClientText.UNDO_REMOVAL, name="robot1")
    await pilot.press("enter")  # the focus is on No
    await gone(pilot, "Undo the removal")
    assert load(path).clients == (ROBOT2,)
    await pilot.press("u")
    await shown(pilot, ClientText.UNDO_REMOVAL, name="robot1")
    await pilot.press("y")
    await gone(pilot, "Undo the removal")
    assert engine_of(app).commands == [("remove client", "robot1"), ("add client", ROBOT1)]
    assert sorted(load(path).listed_clients, key=lambda client: client.name) == [ROBOT1, ROBOT2]
    assert app.changes.last is None
    assert read_key(path.with_name("robot1.key")) == key


@on_links()
async def test_what_is_not_saved_stays_to_be_saved(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    """A client that is added goes into the file alone."""
    kept = Client("robot1", "robot1.key", topics=(Topic("/new", "transmit"),))
    engine_of(app).session = replace(SERVER, clients=(kept, ROBOT2))
    await robot3_added(pilot)
    await shown(pilot, "robot3 is added")
    assert load(path).clients == (ROBOT1, ROBOT2, Client("robot3", "robot3.key"))


@on_links()
async def test_refusals_are_said(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    path.chmod(0o444)
    await robot3_added(pilot)
    await notified(pilot, SavingProblem.READ_ONLY, path=path)  # in lines as long as the path lets them be
    assert engine_of(app).commands == []
    assert not path.with_name("robot3.key").exists()


@pytest.mark.parametrize(("session", "readonly"), [(SERVER, True), (SESSION, False)], ids=["True", "False"])
@on_main(given=("session", "readonly"))
async def test_only_a_servers_operator_has_these_keys(
    app: ConsoleApp, pilot: Pilot[None], session: Session, readonly: bool
) -> None:
    await pilot.press("c")
    await shown(pilot, "esc close")
    await gone(pilot, CLIENT_KEYS)
    await pilot.press("a", "d")
    await pilot.pause()
    await gone(pilot, "Add a client")
    await gone(pilot, "Remove the client")


@on_links()
async def test_removed_client_without_key_gets_no_new_one(app: ConsoleApp, pilot: Pilot[None], path: Path) -> None:
    await pilot.press("d", "y")
    await shown(pilot, "robot1: removed")
    path.with_name("robot1.key").unlink()
    await back_on_main(app, pilot, path)
    await pilot.press("u")
    await shown(pilot, "Not undone")
    assert engine_of(app).commands == [("remove client", "robot1")]
    assert not path.with_name("robot1.key").exists()


# -- a new session ---------------------------------------------------------------------------------------------------


async def new_server(pilot: Pilot[None]) -> None:
    await pilot.press("n")
    await shown(pilot, "Session file")
    await choose(pilot, "role", "server")


@on_welcome()
async def test_a_fleets_server_is_made_with_its_keys(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    own = write_key(folder / "robot1.key")
    await new_server(pilot)
    await fill(pilot, name="pc", server_ip="10.0.0.20", clients="robot1, robot2 robot2")
    await shown(pilot, "robot2 occurs twice")
    await fill(pilot, clients="robot1, robot2")
    await shown(pilot, "robot1.key exists, fingerprint")
    await shown(pilot, "robot2.key will be created")
    assert not form_of(app).fields["key_file"].display
    await pilot.press("enter")
    await shown(pilot, HANDOUT)
    await shown(pilot, "name: robot1")
    for group in fingerprint(read_key(folder / "robot2.key")).split():
        await shown_at_the_end(pilot, group, "end")
    await pilot.press("escape")
    await shown(pilot, "/robot2/scan")
    session = load(folder / "pc.yaml")
    assert engine_of(app).session == session
    assert (session.key_file, session.role) == (None, "server")
    assert session.clients == (Client("robot1", "robot1.key"), Client("robot2", "robot2.key"))
    assert read_key(folder / "robot1.key") == own


@on_welcome()
async def test_clients_are_asked_for_only_of_a_server(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    await new_server(pilot)
    await fill(pilot, name="pc", clients="robot1")
    await choose(pilot, "role", "client")
    assert not form_of(app).fields["clients"].display
    assert form_of(app).fields["key_file"].display
    await fill(pilot, server_ip="10.0.0.20")
    await pilot.press("enter")
    await shown(pilot, "/robot2/scan")
    assert load(folder / "pc.yaml").clients is None
