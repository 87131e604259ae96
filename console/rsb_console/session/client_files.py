"""The clients of a server's session file: adding, removing and rekeying them, and the files for a robot."""

from __future__ import annotations

import re
import socket
from contextlib import AbstractContextManager, suppress
from functools import wraps
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Concatenate, NamedTuple, ParamSpec, TypeVar

import msgspec

from rsb_bridge.config.files import is_there, remove_file
from rsb_bridge.config.folder_owner import acting_as, acting_in_folder, folder_owner
from rsb_bridge.config.keys import (
    Key,
    KeyFileError,
    copy_key,
    key_files_by_client,
    key_path,
    read_key,
    shared_key_problem,
    write_key,
)
from rsb_bridge.config.session_changes import (
    ClientError,
    client_named,
    with_changed_client,
    with_client,
    without_client,
)
from rsb_bridge.config.session_file import SessionFile, dump, edited_text, load_file, save
from rsb_bridge.config.validation import validate
from rsb_bridge.installed_features import features_with, guarded
from rsb_bridge.model.session import Client, Session
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable

_P = ParamSpec("_P")
_R = TypeVar("_R")

_ANY_ADDRESS = ("0.0.0.0", "::")  # noqa: S104 (looked for, not bound)
_FAR_AWAY = (("192.0.2.1", socket.AF_INET), ("2001:db8::1", socket.AF_INET6))  # RFC 5737, RFC 3849: nobody's
_WITH_PORT = re.compile(r"(?:\[(?P<bracketed>[^]]+)\]|(?P<host>[^:\[\]]+)):(?P<port>\d+)")
_NOT_IN_FILE_NAMES = re.compile(r"[^\w.-]+")


class ClientFileProblem(Wording):
    """Reasons why the clients of a session file cannot be listed or changed."""

    NOT_A_SERVER = "{path}: this is a client's session; only a server's lists clients"
    KEY_EXISTS = "{path} exists already: give another file, or this one explicitly to use its key"
    NEXT_KEY_OF_SERVER = (
        "{name} uses the server's next_key_file, {file}, and has no key of its own: in the session file, give it "
        "as key_file and remove next_key_file, then run `rsb-console reload`"
    )
    NEXT_KEY_EXISTS = (
        "{name} has a next key already, in {file}: once the robot has it, run `rsb-console client rekey {name} "
        "--finish`; for another key, run `rsb-console client rekey {name}`, which ends its link"
    )
    NO_NEXT_KEY = "{name} has no next key: `rsb-console client rekey {name} --keep-old` makes one"


class RobotFileText(Wording):
    """Advice about a robot's own session file."""

    ADDRESS_GUESSED = "one of the server's addresses; check that this client can reach it"
    SAVE_AS = "save the session there as {file}"
    COPY_SECRET = "copy with `scp -p {files} USER@ROBOT:` (the key is secret: never by mail or chat)"  # noqa: S105 (a text)
    COPY = "copy with `scp {files} USER@ROBOT:`"


class ChangedFile(NamedTuple):
    """A changed session file of a server.

    Attributes:
        file: the file after the change.
        client: the client that changed.
        key_path: the client's key file, or None without encryption.
        key: key in that file, or None without encryption or if the file cannot be read.
    """

    file: SessionFile
    client: Client
    key_path: Path | None
    key: Key | None


def _in_its_folder(
    work: Callable[Concatenate[Path, _P], _R],
) -> Callable[Concatenate[Path, _P], _R]:
    """Do something to a session file with the rights of the user who owns its folder, if root does it."""

    @wraps(work)
    def done(path: Path, /, *arguments: _P.args, **named: _P.kwargs) -> _R:
        with acting_in_folder(path):
            return work(path, *arguments, **named)

    return done


def _reading_keys(path: Path) -> AbstractContextManager[None]:
    """Read the key files that a session names with the rights of its owner.

    With more, root would copy to that owner whatever key the file names.
    """
    return acting_as(_owner(path), path)


def _writing_key(path: Path, key_at: Path) -> AbstractContextManager[None]:
    """Write a key file that a session names with the rights of its owner.

    Beside the session, it is the folder's owner who writes, but replaces no file of anybody else.
    """
    owner = _owner(path)
    if key_at.parent == path.parent:
        try:
            is_writable = key_at.lstat().st_uid == owner
        except FileNotFoundError:
            is_writable = True
        if is_writable:
            return acting_in_folder(path)
    return acting_as(owner, path)


def _owner(path: Path) -> int:
    """Return the user who decides what a session file says."""
    of_folder = folder_owner(path)
    return path.stat().st_uid if of_folder is None else of_folder


@_in_its_folder
def open_server(path: Path) -> SessionFile:
    """Read a server's session file.

    Raises:
        ClientError: it is a client's.
        SessionError: it cannot be read, or has mistakes.
    """
    file = load_file(path)
    if file.session.role != "server":
        raise ClientError(ClientFileProblem.NOT_A_SERVER(path=path))
    return file


def key_file_name(name: str) -> str:
    """Return the default name of a client's key file."""
    return f"{_NOT_IN_FILE_NAMES.sub('_', name)}.key"


def with_key_file(session: Session, client: Client) -> Client:
    """Add the name of a key file to a client that needs one and has none."""
    if client.key_file is not None or not session.use_encryption:
        return client
    return msgspec.structs.replace(client, key_file=key_file_name(client.name))


def key_path_of(file: SessionFile, client: Client) -> Path | None:
    """Return the path of a client's key, or None without encryption."""
    name = client.key_file or file.session.key_file
    return None if name is None or not file.session.use_encryption else key_path(file.path.parent, name)


@_in_its_folder
def add_client(path: Path, client: Client) -> ChangedFile:
    """Add a client to a server's session file, and create its key.

    Args:
        client: client to add. An existing key file is used; otherwise a new one is created in the session's folder.

    Raises:
        ClientError: the name is taken, another client has the key, or a file with the default name of the key exists.
        KeyFileError: the key cannot be created or read.
        SessionError: the session has mistakes, or cannot be saved. A new key is removed then.
    """
    file = open_server(path)
    made_here = client.key_file is None
    client = with_key_file(file.session, client)
    session = with_client(file.session, client)
    edited_text(session, path, file)  # before there is a key
    key_at, key, is_new = key_path_of(file, client), None, False
    if key_at is not None and is_there(key_at):
        if made_here:
            raise ClientError(ClientFileProblem.KEY_EXISTS(path=key_at))
        with _reading_keys(path):
            key = read_key(key_at)
    elif key_at is not None:
        with _writing_key(path, key_at):
            key, is_new = write_key(key_at, owner=path), True  # the server's user has to read it
    try:
        with _reading_keys(path):
            _check_key_of_its_own(file, session, client, key)
        return ChangedFile(save(session, path, file), client, key_at, key)
    except BaseException:
        # This holds after a Ctrl-C, too: a second attempt would refuse the key file of the first one.
        if is_new and key_at is not None:
            _remove_key(path, key_at)
        raise


def _remove_key(path: Path, key_at: Path) -> None:
    """Remove a key file that a session names."""
    with _writing_key(path, key_at):
        remove_file(key_at)


def _check_key_of_its_own(file: SessionFile, session: Session, client: Client, key: Key | None) -> None:
    """Refuse a key that another client has, unless the session allows shared keys."""
    if key is None:
        return
    # Clients that share a key already are the server's to refuse when it starts.
    others = {client.name: [key]}
    for name, files in key_files_by_client(file.session).items():
        for each in files:
            # The server reports another client's bad key when it starts.
            with suppress(KeyFileError):
                if read_key(key_path(file.path.parent, each)) == key:
                    others[name] = [key]
    if problem := shared_key_problem(session, others):
        raise ClientError(problem)


@_in_its_folder
def remove_client(path: Path, name: str) -> ChangedFile:
    """Remove a client from a server's session file. Its key file stays.

    Raises:
        ClientError: there is no such client, or no other.
        SessionError: the file cannot be saved.
    """
    file = open_server(path)
    client = client_named(file.session, name)
    saved = save(without_client(file.session, name), path, file)
    return ChangedFile(saved, client, key_path_of(file, client), None)


@_in_its_folder
def rekey_client(path: Path, name: str) -> ChangedFile:
    """Create a new key for a client of a server's session file; all its earlier keys become invalid.

    A client that shared a key gets one of its own. A next key that it had is given up.

    Raises:
        ClientError: there is no such client, or no encryption, or its next key is the whole server's.
        KeyFileError: the key cannot be made.
        SessionError: the file cannot be saved.
    """
    file = open_server(path)
    client = client_named(file.session, name)
    check_encrypted(file)
    check_own_next_key(file.session.next_key_file, client.next_key_file, name)
    others = {place for each in file.session.accepted_clients if each.name != name for place in key_places(file, each)}
    key_at = key_path_of(file, client)
    if key_at is not None and key_at not in others:
        if client.next_key_file is not None:
            # The session is saved before the key: a next key that is still in the file would count with the new one.
            client = msgspec.structs.replace(client, next_key_file=None)
            file = save(with_changed_client(file.session, client), path, file)
        with _writing_key(path, key_at):
            return ChangedFile(file, client, key_at, write_key(key_at, force=True, owner=path))
    renewed = msgspec.structs.replace(client, key_file=free_key_file(path.parent, name), next_key_file=None)
    key_at = key_path_of(file, renewed)
    assert key_at is not None
    session = with_changed_client(file.session, renewed)
    edited_text(session, path, file)  # before there is a key
    with _writing_key(path, key_at):
        key = write_key(key_at, owner=path)
    return ChangedFile(save(session, path, file), renewed, key_at, key)


def key_places(file: SessionFile, client: Client) -> list[Path]:
    """Return the paths of a client's valid keys, the next one last; empty without encryption."""
    files = key_files_by_client(file.session)[client.name] if file.session.use_encryption else ()
    return [key_path(file.path.parent, each) for each in files]


def check_encrypted(file: SessionFile) -> None:
    """Raise a ClientError if the session has no keys."""
    if not file.session.use_encryption:
        raise ClientError(f"{file.path}: encryption is off (use_encryption): there are no keys")


def check_own_next_key(of_session: str | None, of_client: str | None, name: str) -> None:
    """Raise a ClientError if all clients share the next key, so that giving it up would affect all."""
    if of_session is not None and of_client is None:
        raise ClientError(ClientFileProblem.NEXT_KEY_OF_SERVER(name=name, file=of_session))


def free_key_file(folder: Path, name: str) -> str:
    """Return the name of a key file that does not exist yet."""
    own = key_file_name(name)
    others = (f"{own.removesuffix('.key')}-{number}.key" for number in count(2))
    return next(each for each in chain((own,), others) if not is_there(folder / each))


# --- what the robot needs


def handed_out(file: SessionFile) -> list[ChangedFile]:
    """Return the client's entry and key for each client of a server."""
    places = [(client, key_path_of(file, client)) for client in file.session.accepted_clients]
    return [ChangedFile(file, client, key_at, fingerprint_or_problem(key_at)[0]) for client, key_at in places]


def split_address(address: str) -> tuple[str, int | None]:
    """Split an address with or without a port, such as ``10.0.0.20:49152`` or ``[::1]:49152``.

    Returns:
        The address alone, and the port or None.
    """
    found = _WITH_PORT.fullmatch(address)
    if found is None:
        return address, None
    return found["host"] or found["bracketed"], int(found["port"])


def check_address(name: str, address: str) -> None:
    """Check the value of `--address` before anything is written.

    Args:
        address: the server's address as the client reaches it, or empty.

    Raises:
        ClientError: no client can connect to that address.
    """
    if not address:
        return
    host, port = split_address(address)
    # Without a port, any valid one will do, since only the address is judged.
    trial = Session(name=name, role="client", server_ip=host, server_port=1024 if port is None else port)
    for problem in validate(trial):
        if problem.location in ("server_ip", "server_port"):
            raise ClientError(f"--address {address}: {problem.message}")


def robot_file(session: Session, client: Client, address: str = "") -> str:
    """Return the text of a client's own session file.

    Args:
        address: of the server, as the client reaches it, perhaps with its port; if empty, the one that the server
            binds, or a guess.
    """
    address, port = split_address(address)
    guessed = not address and session.host in _ANY_ADDRESS
    key_file = client.key_file or session.key_file
    robot = Session(
        name=client.name,
        role="client",
        server_ip=address or (own_address() if guessed else session.host),
        server_port=session.server_port if port is None else port,
        bluetooth_address=session.bluetooth_address,
        use_encryption=session.use_encryption,
        key_file=key_file.rpartition("/")[2] if key_file is not None and session.use_encryption else None,
    )
    for feature in features_with("client_session"):
        with guarded(feature, "client_session"):
            robot = feature.client_session(session, robot, address, port)
    lines = dump(robot).splitlines()
    if guessed:
        at = next(number for number, line in enumerate(lines) if line.startswith("server_ip:"))
        lines[at] += f"   # {RobotFileText.ADDRESS_GUESSED()}"
    head = f"# {client.name}, a client of the server {session.name}. Its key file belongs in the same folder."
    topics = "# topics:", "#   - {topic: /scan, direction: transmit}"
    return "".join(f"{line}\n" for line in (head, *lines, *topics))


def own_address() -> str:
    """Return this machine's address towards other networks, or its host name without such a network."""
    for address, family in _FAR_AWAY:
        with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((address, 9))  # sends nothing
            own: str = probe.getsockname()[0]
            return own
    return socket.gethostname()


def copy_advice(client: Client, key_at: Path | None, robot_at: Path | None = None) -> str:
    """Return the advice for copying the key to the robot.

    Args:
        key_at: its key file, or None without encryption.
        robot_at: the robot's session file if it is written already, or None.
    """
    files = " ".join(str(path) for path in (robot_at, key_at) if path is not None)
    own_file = f"{key_file_name(client.name)[:-4]}.yaml"
    save_as = "" if robot_at is not None else RobotFileText.SAVE_AS(file=own_file)
    copy = RobotFileText.COPY_SECRET if key_at else RobotFileText.COPY
    return "; ".join(part for part in (save_as, copy(files=files) if files else "") if part)


def fingerprint_or_problem(key_at: Path | None) -> tuple[Key | None, str]:
    """Return the key in a file, or the file's problem."""
    if key_at is None:
        return None, "not encrypted"
    try:
        return read_key(key_at), ""
    except KeyFileError as error:
        return None, str(error)


@_in_its_folder
def begin_rotation(path: Path, name: str) -> ChangedFile:
    """Create a client's next key, valid together with the present one. Return the next key.

    Raises:
        ClientError: no such client, no encryption, no key to replace, or a next key exists already.
        KeyFileError: the key cannot be created.
        SessionError: the file cannot be saved. The next key is removed then.
    """
    file = open_server(path)
    client = client_named(file.session, name)
    check_encrypted(file)
    current = key_path_of(file, client)
    assert current is not None  # else the session has a mistake
    if (places := key_places(file, client))[1:]:
        raise ClientError(ClientFileProblem.NEXT_KEY_EXISTS(name=name, file=places[1]))
    key_file = Path(client.key_file or file.session.key_file or "")
    following = str(key_file.with_name(free_key_file(current.parent, f"{key_file.stem}-next")))
    renewed = msgspec.structs.replace(client, next_key_file=following)
    session = with_changed_client(file.session, renewed)
    edited_text(session, path, file)  # before there is a key
    key_at = key_path(path.parent, following)
    with _writing_key(path, key_at):
        key = write_key(key_at, owner=path)
    try:
        return ChangedFile(save(session, path, file), renewed, key_at, key)
    except BaseException:
        _remove_key(path, key_at)
        raise


@_in_its_folder
def finish_rotation(path: Path, name: str) -> ChangedFile:
    """Replace a client's old key by the next one, in the same file. Return that key.

    The old key's file is replaced first. If this ends before the session is saved, both files hold the new key, and it
    can be done again.

    Raises:
        ClientError: there is no such client, or it has no next key of its own.
        KeyFileError: the next key cannot be read, or not put in place.
        SessionError: the file cannot be saved.
    """
    file = open_server(path)
    client = client_named(file.session, name)
    check_encrypted(file)
    places = key_places(file, client)
    if not places[1:]:
        raise ClientError(ClientFileProblem.NO_NEXT_KEY(name=name))
    check_own_next_key(file.session.next_key_file, client.next_key_file, name)
    current, following = places
    with _reading_keys(path):
        key = read_key(following)
    others = {place for each in file.session.accepted_clients if each.name != name for place in key_places(file, each)}
    is_shared = current in others
    key_file = client.next_key_file if is_shared else client.key_file
    renewed = msgspec.structs.replace(client, key_file=key_file, next_key_file=None)
    session = with_changed_client(file.session, renewed)
    edited_text(session, path, file)
    if not is_shared:
        with _writing_key(path, current):
            copy_key(key, current, force=True, owner=path)
    saved = save(session, path, file)
    if not is_shared:
        _remove_key(path, following)
    return ChangedFile(saved, renewed, following if is_shared else current, key)
