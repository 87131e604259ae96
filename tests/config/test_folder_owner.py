"""Root writes into the folder of another user, who puts links there to root's own files."""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace
from tests.support.other_user import OTHER, folder_for_all, only_root, process_of_other, theirs

from rsb_bridge.config.files import make_folder, owner_only, remove_file, replace_file, write_whole
from rsb_bridge.config.folder_owner import acting_as, acting_in_folder, folder_owner
from rsb_bridge.config.keys import KeyFileError, read_key, write_key
from rsb_bridge.config.session_file import SessionError, load_file, save
from rsb_bridge.model.session import Client, Session
from rsb_console.session import client_files

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytestmark = only_root
ROBOT1 = Client("robot1", "robot1.key")
SERVER = Session(name="pc", role="server", server_ip="10.0.0.20", server_port=49152, clients=(ROBOT1,))
WRITERS: dict[str, Callable[[Path], object]] = {
    "replace_file": lambda path: replace_file(path, b"new"),
    "write_whole": lambda path: write_whole(path, "new"),
    "write_key": write_key,
    "owner_only": lambda path: os.close(owner_only(str(path), os.O_WRONLY | os.O_CREAT)),
    "make_folder": make_folder,
    "save": lambda path: save(SERVER, path),
}


class Place:
    """Root's folder, and another user's beside it.

    Attributes:
        own: root's, which only root may enter.
        other: the other user's.
    """

    def __init__(self, folder: Path) -> None:
        self.own, self.other = folder / "own", folder / "other"
        self.own.mkdir(mode=0o700)
        self.other.mkdir()
        theirs(self.other)

    def session(self, session: Session = SERVER, name: str = "pc.yaml") -> Path:
        """Return the other user's session file, with the key of its client."""
        path = self.other / name
        save(session, path)
        key = self.other / "robot1.key"
        write_key(key)
        theirs(key)
        return theirs(path)


@pytest.fixture
def place() -> Iterator[Place]:
    with folder_for_all() as folder:
        yield Place(folder)


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_new_file_belongs_to_folders_owner(place: Place, write: Callable[[Path], object]) -> None:
    path = place.other / "a.yaml"
    write(path)
    assert (path.stat().st_uid, path.stat().st_gid) == (OTHER, OTHER)


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_no_folders_link_leads_to_root(place: Place, write: Callable[[Path], object]) -> None:
    theirs_to_own = place.other / "sub"
    theirs_to_own.symlink_to(place.own)
    theirs(theirs_to_own)
    with pytest.raises((OSError, KeyFileError, SessionError)):
        write(theirs_to_own / "a.yaml")
    assert not [*place.own.iterdir()]


def test_nothing_of_roots_is_removed(place: Place) -> None:
    (place.own / "a").write_text("kept")
    (place.other / "sub").symlink_to(place.own)
    with pytest.raises(PermissionError):
        remove_file(place.other / "sub" / "a")
    assert (place.own / "a").read_text() == "kept"


def test_backup_copies_nothing_of_roots(place: Place) -> None:
    secret, path = place.own / "secret.yaml", place.other / "pc.yaml"
    save(replace(SERVER, domain_id=42), secret)
    path.symlink_to(secret)  # root's own link, so that nothing but the rights of the folder's owner stops it
    with pytest.raises(SessionError):
        save(SERVER, path)
    assert [each.name for each in place.other.iterdir()] == ["pc.yaml"]
    assert load_file(secret).session.domain_id == 42


def test_file_of_another_in_shared_folder_stays(place: Place) -> None:
    shared = place.own.parent / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    path = shared / "a"
    path.write_text("theirs")
    theirs(path)
    with pytest.raises(PermissionError):
        replace_file(path, b"root's secret")
    assert path.read_text() == "theirs"


def test_other_threads_keep_their_rights(place: Place) -> None:
    (place.own / "a").write_text("kept")
    read: list[str] = []
    acts = threading.Event()

    def look() -> None:
        acts.wait(60)
        read.append((place.own / "a").read_text())

    reader = threading.Thread(target=look)
    reader.start()  # before: a new thread has the rights of the one that starts it
    with acting_in_folder(place.other / "a"):
        acts.set()
        reader.join()
        with pytest.raises(PermissionError):
            (place.own / "a").read_text()
    assert read == ["kept"]
    assert (place.own / "a").read_text() == "kept"


def test_rights_of_groups_are_the_others(place: Place) -> None:
    before = os.getgroups()
    os.setgroups([0])
    try:
        place.own.chmod(0o770)
        with acting_in_folder(place.other / "a"), pytest.raises(PermissionError):
            (place.own / "a").write_text("")
        assert os.getgroups() == [0]
    finally:
        os.setgroups(before)


def test_second_user_brings_no_further_rights(place: Place) -> None:
    third = place.own.parent / "third"
    third.mkdir(mode=0o700)
    os.chown(third, 1234, 1234)
    with acting_as(OTHER, place.other), pytest.raises(PermissionError):
        replace_file(third / "a", b"")


@pytest.mark.parametrize(
    ("path", "owner"),
    [("own/a", None), ("other/a", OTHER), ("other/../own/a", OTHER), ("link", OTHER), ("roots_link", OTHER)],
)
def test_first_owner_but_root_decides(place: Place, path: str, owner: int | None) -> None:
    folder = place.own.parent
    (folder / "link").symlink_to(place.own / "a")
    theirs(folder / "link")
    (folder / "roots_link").symlink_to("other/a")
    assert folder_owner(folder / path) == owner


# --- clients of a session that belongs to another user


def test_swapped_key_gives_nothing_away(place: Place) -> None:
    path, victim = place.session(), place.own / "victim"
    victim.write_text("root's")
    with process_of_other(partial(_swap, place.other, victim)):
        for number in range(2, 8):
            with suppress(OSError, KeyFileError, SessionError):
                client_files.add_client(path, Client(f"robot{number}"))
            with suppress(OSError, KeyFileError, SessionError):
                client_files.rekey_client(path, "robot1")
    assert (victim.stat().st_uid, victim.read_text()) == (0, "root's")


def _swap(folder: Path, victim: Path) -> None:
    """Put a link in the place of each new key, as soon as it is there."""
    known = {"robot1.key"}
    while True:
        for name in {each for each in os.listdir(folder) if each.endswith(".key")} - known:  # noqa: PTH208 -- quick
            known.add(name)
            with suppress(OSError):
                (folder / name).rename(folder / f"{name}.mine")
                (folder / name).symlink_to(victim)
        time.sleep(0)


@pytest.mark.parametrize("is_beside", [True, False], ids=["root's folder", "their folder"])
@pytest.mark.parametrize("name", ["secret.key", "link.key"])
def test_session_has_no_key_of_roots_copied(place: Place, name: str, *, is_beside: bool) -> None:
    secret = write_key(place.own / "secret.key")
    (place.other / "link.key").symlink_to(place.own / "secret.key")
    named = str((place.own if name == "secret.key" else place.other) / name)
    rotating = replace(SERVER, clients=(replace(ROBOT1, next_key_file=named),))
    path = place.session(rotating)
    if is_beside:
        path = path.rename(place.own.parent / "pc.yaml")
        (place.other / "robot1.key").rename(path.with_name("robot1.key"))
    with pytest.raises(KeyFileError):
        client_files.finish_rotation(path, "robot1")
    assert read_key(path.with_name("robot1.key")) != secret


@pytest.mark.parametrize("is_beside", [True, False], ids=["root's folder", "their folder"])
def test_session_has_no_key_of_roots_replaced(place: Place, *, is_beside: bool) -> None:
    secret = write_key(place.own / "secret.key")
    path = place.session(replace(SERVER, clients=(Client("robot1", str(place.own / "secret.key")),)))
    if is_beside:
        path = path.rename(place.own.parent / "pc.yaml")
    with pytest.raises(KeyFileError):
        client_files.rekey_client(path, "robot1")
    assert read_key(place.own / "secret.key") == secret
    with pytest.raises((OSError, KeyFileError)):
        client_files.begin_rotation(path, "robot1")
    assert [each.name for each in place.own.iterdir()] == ["secret.key"]


def test_service_in_roots_folder_gets_its_keys(place: Place) -> None:
    """As in /etc/rsb-console: the folder is root's, the files are the service's."""
    path = place.session().rename(place.own.parent / "pc.yaml")
    (place.other / "robot1.key").rename(path.with_name("robot1.key"))
    client_files.add_client(path, Client("robot2"))
    client_files.begin_rotation(path, "robot1")
    client_files.finish_rotation(path, "robot1")
    client_files.rekey_client(path, "robot2")
    files = {each.name: each.stat().st_uid for each in path.parent.iterdir() if each.is_file()}
    assert files == dict.fromkeys(("pc.yaml", "pc.yaml~", "robot1.key", "robot2.key"), OTHER)


def test_no_module_changes_owners_by_path() -> None:
    packages = [Path(__file__).parents[2] / each for each in ("bridge", "console", "extras")]
    by_path = (".chown(", ".chmod(", "give_owner(")
    found = {
        path.name
        for package in packages
        for path in package.rglob("*.py")
        if "tests" not in path.parts and any(each in path.read_text() for each in by_path)
    }
    # The first by a descriptor, the second in a temporary folder, the third beside what it checks.
    assert found <= {"files.py", "loopback.py", "control_sockets.py"}
