"""A server's clients in the console: added and removed while it runs, and made with a new session."""

from pathlib import Path

import pytest
from msgspec.structs import replace
from tests.console.driving import (
    NARROW,
    choose,
    drive,
    empty_app,
    engine_of,
    fill,
    form_of,
    gone,
    notified,
    scripted_app,
    shown,
    shown_at_the_end,
)
from tests.console.scripted import SESSION
from tests.support.long import long
from textual.pilot import Pilot

from rsb_bridge.config.keys import fingerprint, read_key, write_key
from rsb_bridge.config.session_file import SavingProblem, load, save
from rsb_bridge.model.session import Client, Topic
from rsb_console.screens.clients_screen import ClientText
from rsb_console.screens.links_screen import CLIENT_KEYS
from rsb_console.screens.new_session import HANDOUT

pytestmark = pytest.mark.usefixtures("folder")
SERVER = replace(SESSION, name="pc", role="server", key_file=None, clients=(Client("robot1", key_file="robot1.key"),))


@pytest.fixture
def path(folder: Path) -> Path:
    """A server's session file."""
    path = folder / "pc.yaml"
    save(SERVER, path)
    path.write_text(f"# the fleet\n{path.read_text()}")
    write_key(folder / "robot1.key")
    return path


def protect(path: Path) -> None:
    """Make a file read-only."""
    path.chmod(0o444)


async def links(pilot: Pilot[None]) -> None:
    """Open the links."""
    await shown(pilot, "/robot2/scan")
    await pilot.press("c")
    await shown(pilot, CLIENT_KEYS)


@pytest.mark.parametrize("size", [*long((120, 36)), NARROW])
def test_a_client_is_added_at_once_and_in_the_file(path: Path, size: tuple[int, int]) -> None:
    app = scripted_app(session=load(path), path=path)

    async def steps(pilot: Pilot[None]) -> None:
        await links(pilot)
        await pilot.press("a")
        await shown(pilot, "Add a client")
        await fill(pilot, name="robot1")
        await shown(pilot, ClientText.EXISTS)
        await fill(pilot, name="robot2", deny="/camera/*, raw")
        await shown(pilot, "'raw' matches no topic")
        await fill(pilot, deny="/camera/* /raw")
        await pilot.press("enter")
        await shown(pilot, "robot2 is added")
        await shown(pilot, "name: robot2")
        key = read_key(path.with_name("robot2.key"))
        for group in fingerprint(key).split():  # the line breaks wherever the path before it leaves it no room
            await shown_at_the_end(pilot, group, "end")
        added = Client("robot2", "robot2.key", deny=("/camera/*", "/raw"))
        assert engine_of(app).commands == [("add client", added)]
        assert load(path).clients == (*SERVER.listed_clients, added)
        await pilot.press("escape")
        await gone(pilot, "robot2 is added")
        assert app.saved == load(path), "nothing is left to save"

    drive(app, steps, size=size)
    assert path.read_text().startswith("# the fleet\n")


def test_a_client_is_removed_only_with_a_yes(path: Path) -> None:
    save(replace(SERVER, clients=(*SERVER.listed_clients, Client("robot2", "robot2.key"))), path)
    app = scripted_app(session=load(path), path=path)

    async def steps(pilot: Pilot[None]) -> None:
        await links(pilot)
        await pilot.press("d")
        await shown(pilot, "Remove the client robot1?")
        await pilot.press("enter")  # the focus is on No
        await gone(pilot, "Remove the client robot1?")
        assert engine_of(app).commands == []
        await pilot.press("d", "y")
        await shown(pilot, "robot1: removed")
        assert engine_of(app).commands == [("remove client", "robot1")]
        assert [client.name for client in load(path).listed_clients] == ["robot2"]
        assert path.with_name("robot1.key").exists()

    drive(app, steps)


def test_what_is_not_saved_stays_to_be_saved(path: Path) -> None:
    """A client that is added goes into the file alone."""
    app = scripted_app(session=load(path), path=path)

    async def steps(pilot: Pilot[None]) -> None:
        await links(pilot)
        kept = (Client("robot1", "robot1.key", topics=(Topic("/new", "transmit"),)),)
        engine_of(app).session = replace(SERVER, clients=kept)
        await pilot.press("a")
        await shown(pilot, "Add a client")
        await fill(pilot, name="robot2")
        await pilot.press("enter")
        await shown(pilot, "robot2 is added")
        assert load(path).clients == (*SERVER.listed_clients, Client("robot2", "robot2.key"))

    drive(app, steps)


def test_refusals_are_said(path: Path) -> None:
    app = scripted_app(session=load(path), path=path)

    async def steps(pilot: Pilot[None]) -> None:
        await links(pilot)
        protect(path)
        await pilot.press("a")
        await shown(pilot, "Add a client")
        await fill(pilot, name="robot2")
        await pilot.press("enter")
        await notified(pilot, SavingProblem.READ_ONLY, path=path)  # in lines as long as the path lets them be
        assert engine_of(app).commands == []
        assert not path.with_name("robot2.key").exists()

    drive(app, steps)


@pytest.mark.parametrize("readonly", [True, False])
def test_only_a_servers_operator_has_these_keys(path: Path, readonly: bool) -> None:
    app = scripted_app(session=SERVER, path=path, readonly=True) if readonly else scripted_app()

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        await pilot.press("c")
        await shown(pilot, "esc close")
        await gone(pilot, CLIENT_KEYS)
        await pilot.press("a", "d")
        await pilot.pause()
        await gone(pilot, "Add a client")
        await gone(pilot, "Remove the client")

    drive(app, steps)


# -- a new session ---------------------------------------------------------------------------------------------------


async def new_server(pilot: Pilot[None]) -> None:
    """Begin a new server's session."""
    await shown(pilot, "New session")
    await pilot.press("n")
    await shown(pilot, "Session file")
    await choose(pilot, "role", "server")


def test_a_fleets_server_is_made_with_its_keys(folder: Path) -> None:
    app = empty_app()
    own = write_key(folder / "robot1.key")

    async def steps(pilot: Pilot[None]) -> None:
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
        assert engine_of(app).session == load(folder / "pc.yaml")

    drive(app, steps)
    session = load(folder / "pc.yaml")
    assert (session.key_file, session.role) == (None, "server")
    assert session.clients == (Client("robot1", "robot1.key"), Client("robot2", "robot2.key"))
    assert read_key(folder / "robot1.key") == own


def test_clients_are_asked_for_only_of_a_server(folder: Path) -> None:
    app = empty_app()

    async def steps(pilot: Pilot[None]) -> None:
        await new_server(pilot)
        await fill(pilot, name="pc", clients="robot1")
        await choose(pilot, "role", "client")
        assert not form_of(app).fields["clients"].display
        assert form_of(app).fields["key_file"].display
        await fill(pilot, server_ip="10.0.0.20")
        await pilot.press("enter")
        await shown(pilot, "/robot2/scan")

    drive(app, steps)
    assert load(folder / "pc.yaml").clients is None


# -- taken back ------------------------------------------------------------------------------------------------------


async def back_on_main(pilot: Pilot[None]) -> None:
    """Close the links."""
    await pilot.press("escape")
    await gone(pilot, CLIENT_KEYS)


def test_a_removed_client_comes_back_with_its_key(path: Path) -> None:
    robot2 = Client("robot2", "robot2.key", deny=("/raw",))
    save(replace(SERVER, clients=(*SERVER.listed_clients, robot2)), path)
    key = write_key(path.with_name("robot2.key"))
    app = scripted_app(session=load(path), path=path)

    async def steps(pilot: Pilot[None]) -> None:
        await links(pilot)
        await pilot.press("d", "y")
        await shown(pilot, "robot1: removed")
        engine_of(app).session = load(path)
        await back_on_main(pilot)
        await pilot.press("u")
        await shown(pilot, ClientText.UNDO_REMOVAL, name="robot1")
        await pilot.press("enter")  # the focus is on No
        await gone(pilot, "Undo the removal")
        assert len(load(path).listed_clients) == 1
        await pilot.press("u")
        await shown(pilot, ClientText.UNDO_REMOVAL, name="robot1")
        await pilot.press("y")
        await gone(pilot, "Undo the removal")
        (robot1,) = SERVER.listed_clients
        assert engine_of(app).commands == [("remove client", "robot1"), ("add client", robot1)]
        assert set(load(path).listed_clients) == {robot1, robot2}
        assert app.changes.last is None

    drive(app, steps)
    assert read_key(path.with_name("robot2.key")) == key


def test_a_removed_client_whose_key_is_gone_is_not_given_a_new_one(path: Path) -> None:
    save(replace(SERVER, clients=(*SERVER.listed_clients, Client("robot2", "robot2.key"))), path)
    app = scripted_app(session=load(path), path=path)

    async def steps(pilot: Pilot[None]) -> None:
        await links(pilot)
        await pilot.press("d", "y")
        await shown(pilot, "robot1: removed")
        engine_of(app).session = load(path)
        path.with_name("robot1.key").unlink()
        await back_on_main(pilot)
        await pilot.press("u")
        await shown(pilot, "Not undone")
        assert engine_of(app).commands == [("remove client", "robot1")]
        assert not path.with_name("robot1.key").exists()

    drive(app, steps)


def test_an_added_client_is_removed_again(path: Path) -> None:
    app = scripted_app(session=load(path), path=path)

    async def steps(pilot: Pilot[None]) -> None:
        await links(pilot)
        await pilot.press("a")
        await shown(pilot, "Add a client")
        await fill(pilot, name="robot2")
        await pilot.press("enter")
        await shown(pilot, "robot2 is added")
        await pilot.press("escape")
        await gone(pilot, "robot2 is added")
        engine_of(app).session = load(path)
        await back_on_main(pilot)
        await pilot.press("u")
        await shown(pilot, "remove the client robot2?")
        await pilot.press("y")
        await gone(pilot, "remove the client robot2?")
        assert engine_of(app).commands[1:] == [("remove client", "robot2")]
        assert load(path).clients == SERVER.clients
        assert path.with_name("robot2.key").exists()

    drive(app, steps)
