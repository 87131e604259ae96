"""`rsb-console client`: the clients of a server, in its session file and on the bridge that runs it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.api import EngineError
from rsb_bridge.config.files import is_there, why_not_written, write_whole
from rsb_bridge.config.grants import GrantError, typed_grants
from rsb_bridge.config.keys import fingerprint
from rsb_bridge.config.session_changes import ClientError, client_named
from rsb_bridge.control.bridges import ask, running_bridges
from rsb_bridge.control.remote_engine import attach
from rsb_bridge.installed_features import added
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import AddClient, ChangeClient, RemoveClient
from rsb_bridge.model.session import Client, Grant
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.wording import Wording
from rsb_console.command.formatting import clock
from rsb_console.command.shell import OK, print_error, print_lines
from rsb_console.command.target import NoBridgeError, UsageError, agreed, chosen_bridge, done, result
from rsb_console.session import client_files

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.model.commands import Command
    from rsb_bridge.model.snapshot import Event, LinkSnapshot
    from rsb_console.session.client_files import ChangedFile


class ClientCommandProblem(Wording):
    """Reasons why a change of a server's clients is refused."""

    OUTPUT_EXISTS = "{path} exists already: name another file for the robot's session"
    OUTPUT_OF_ROTATION = "the client's session file stays as it is: leave out --output and --address"
    OLD_KEY_IN_USE = (
        "{name} is linked with its old key, {fingerprint}: not finished. Copy the new key over the robot's and "
        "run `rsb-console reload` there; or end its link now: `rsb-console client rekey {name}`"
    )
    NOT_FINISHED = "not finished: both keys of {name} stay valid"
    SESSION_UNKNOWN = "{problem}: name the server's session file"
    OF_ANOTHER_USER = "{name} is another user's bridge, which may name any file: name the server's session file"
    BRIDGE_REFUSES = (
        "{path} is saved, but the bridge that runs it refuses: {reason}; restart it, or `rsb-console reload {name}`"
    )


class ClientEffect(Wording):
    """Effects of a change of clients on the server that runs the session, and the steps that follow."""

    NOT_RUNNING = "no server with this file runs here; the change takes effect at its next start"
    SAVED = "{path} is saved; {effect}"
    ADDED = "it accepts the client from now on"
    REKEYED = "only the new key counts now"
    REKEYED_LINK_CLOSED = "only the new key counts now, and the link is closed"
    BOTH_KEYS = "both keys count from now on"
    BOTH_KEYS_LINK_STAYS = "both keys count from now on, and the link stays"
    USED = "{name} is not linked; it used the new key last, on {when}"
    REMOVED = "{name} is no longer accepted, and was not linked"
    REMOVED_LINK_CLOSED = "{name} is no longer accepted, and its link is closed"
    STEP_FINISH = "here: `rsb-console client rekey {name} --finish` (the old key becomes invalid)"


# --- the commands


def add_client(arguments: Namespace) -> int:
    path = _session_path(arguments)
    client_files.check_address(arguments.name, arguments.address)
    output: Path | None = arguments.output
    # This is checked first: an error after the change would leave a client whose robot has no file.
    if output is not None and is_there(output):
        raise ClientError(ClientCommandProblem.OUTPUT_EXISTS(path=output))
    client = Client(
        name=arguments.name,
        key_file=arguments.key_file,
        use_name=arguments.use_name,
        allow=_grants(arguments.allow),
        deny=_grants(arguments.deny),
    )
    changed = client_files.add_client(path, client)
    added = ClientEffect.ADDED()
    told = _tell(arguments, path, AddClient(changed.client), added, added)
    return _handed_out(arguments, changed, told)


def _grants(entries: list[str]) -> tuple[str | Grant, ...]:
    try:
        return tuple(grant for entry in entries for grant in typed_grants(entry))
    except GrantError as error:
        raise UsageError(str(error)) from None


def rekey_client(arguments: Namespace) -> int:
    path = _session_path(arguments)
    # Only the key changes: what the robot's session file says stays true.
    if (arguments.keep_old or arguments.finish) and (arguments.output or arguments.address):
        raise ClientError(ClientCommandProblem.OUTPUT_OF_ROTATION())
    if arguments.keep_old:
        return _begin_rotation(arguments, path)
    if arguments.finish:
        return _finish_rotation(arguments, path)
    client_files.check_address(arguments.name, arguments.address)
    changed = client_files.rekey_client(path, arguments.name)
    effects = ClientEffect.REKEYED(), ClientEffect.REKEYED_LINK_CLOSED()
    told = _tell(arguments, path, ChangeClient(changed.client), *effects)
    return _handed_out(arguments, changed, told)


def _begin_rotation(arguments: Namespace, path: Path) -> int:
    changed = client_files.begin_rotation(path, arguments.name)
    effects = ClientEffect.BOTH_KEYS(), ClientEffect.BOTH_KEYS_LINK_STAYS()
    told = _tell(arguments, path, ChangeClient(changed.client), *effects)
    key_file = changed.client.key_file or changed.file.session.key_file or ""
    steps = (
        f"copy the new key over the robot's: `scp -p {changed.key_path} USER@ROBOT:{Path(key_file).name}`",
        "on the robot: `rsb-console reload` (its link comes back at once)",
        ClientEffect.STEP_FINISH(name=arguments.name),
    )
    return _rotated(arguments, changed, told, "the next key", steps)


def _finish_rotation(arguments: Namespace, path: Path) -> int:
    name = arguments.name
    link = _links(path, arguments.control).get(name)
    if link is not None and link.state is State.OK:
        # --yes does not help here: the robot that is linked now would be shut out.
        if link.fingerprint != link.next_fingerprint:
            raise EngineError(ClientCommandProblem.OLD_KEY_IN_USE(name=name, fingerprint=link.fingerprint))
    elif not arguments.yes:
        _ask_to_finish(arguments, path, name)
    changed = client_files.finish_rotation(path, name)
    effects = f"{ClientEffect.REKEYED()}, and {name} needs it", f"{ClientEffect.REKEYED()}, and the link stays"
    told = _tell(arguments, path, ChangeClient(changed.client), *effects)
    return _rotated(arguments, changed, told, "the key")


def _ask_to_finish(arguments: Namespace, path: Path, name: str) -> None:
    """Ask whether to end a rotation, unless the client used its new key when it was linked last."""
    file = client_files.open_server(path)
    client = client_named(file.session, name)
    if client.next_key_file is None:
        return  # `finish_rotation` refuses that
    keys = (client_files.fingerprint_or_problem(place)[0] for place in client_files.key_places(file, client))
    old, new = ("" if key is None else fingerprint(key) for key in keys)
    used = _last_key(file.session.name, name, {old, new})
    if used is not None and used.new == new:
        print_error(ClientEffect.USED(name=name, when=clock(used.time)))
        return
    last = "and the server's log does not show that it has ever used the new key. Without it, it"
    if used is not None:
        last = f"and used its old key last, on {clock(used.time)}. Without the new one, it"
    if not agreed(f"{name} is not linked, {last} cannot link any more. Finish?", ask=not arguments.json):
        raise EngineError(ClientCommandProblem.NOT_FINISHED(name=name))


def _last_key(server: str, name: str, fingerprints: set[str]) -> Event | None:
    """Return the last event on the server's disk about the use of these keys by a client, or None."""
    found: list[Event] = []
    for events in added("kept_logs", server):
        used = [e for e in events if (e.code, e.link) == (EventCode.KEY_USED, name) and e.new in fingerprints]
        found += used[-1:]  # in the log's order, as a clock that is set back dates later events earlier
    return max(found, key=lambda each: each.time, default=None)


def _rotated(arguments: Namespace, changed: ChangedFile, told: str, what: str, steps: Sequence[str] = ()) -> int:
    """Print the result of a change of a client's keys and the next steps."""
    file, client, key_at, key = changed
    assert key is not None
    if arguments.json:
        return done(
            arguments, name=client.name, session=str(file.path), key_file=str(key_at), fingerprint=fingerprint(key),
            running=told or None,
        )  # fmt: skip
    print_error(f"{client.name}: {what} is in {key_at}, fingerprint {fingerprint(key)}")
    print_error(ClientEffect.SAVED(path=file.path, effect=told or ClientEffect.NOT_RUNNING()))
    for number, step in enumerate(steps, 1):
        print_error(f"{number}. {step}")
    return OK


def show_client(arguments: Namespace) -> int:
    client_files.check_address(arguments.name, arguments.address)
    file = client_files.open_server(_session_path(arguments))
    client = client_named(file.session, arguments.name)
    key_at = client_files.key_path_of(file, client)
    key, problem = client_files.fingerprint_or_problem(key_at)
    if key is None and key_at is not None:
        raise ClientError(problem)
    return _handed_out(arguments, client_files.ChangedFile(file, client, key_at, key), "")


def remove_client(arguments: Namespace) -> int:
    path = _session_path(arguments)
    changed = client_files.remove_client(path, arguments.name)
    effects = (each(name=arguments.name) for each in (ClientEffect.REMOVED, ClientEffect.REMOVED_LINK_CLOSED))
    told = _tell(arguments, path, RemoveClient(arguments.name), *effects)
    if arguments.json:
        return done(arguments, name=arguments.name, running=told or None)
    key_at = changed.key_path
    kept = f"; its key file {key_at} stays: remove it if nothing needs it" if key_at and is_there(key_at) else ""
    print_error(f"{path}: {arguments.name} is removed{kept}; {told or ClientEffect.NOT_RUNNING()}")
    return OK


def list_clients(arguments: Namespace) -> int:
    file = client_files.open_server(_session_path(arguments))
    links = _links(file.path, arguments.control)
    rows, lines = [], []
    for client in file.session.accepted_clients:
        key_at = client_files.key_path_of(file, client)
        key, problem = client_files.fingerprint_or_problem(key_at)
        places = client_files.key_places(file, client)
        following, of_following = client_files.fingerprint_or_problem(places[1] if places[1:] else None)
        mark, next_mark = ("" if each is None else fingerprint(each) for each in (key, following))
        state = links[client.name].state if client.name in links else ""
        rows.append(
            {
                "name": client.name,
                "key_file": None if key_at is None else str(key_at),
                "fingerprint": mark,
                "next_key_file": None if len(places) < 2 else str(places[1]),
                "next_fingerprint": next_mark,
                "problem": problem or (of_following if places[1:] else ""),
                "use_name": client.is_prefixed(file.session),
                "allow": msgspec.to_builtins(client.allow),
                "deny": msgspec.to_builtins(client.deny),
                "topics": [topic.topic for topic in client.topics],
                "state": state,
            }
        )
        keys = f"{mark}{f', next {next_mark}' if next_mark else ''}" if mark else problem
        key_name = "-" if key_at is None else key_at.name
        lines.append(f"{client.name:<16} {state.upper() or '-':<8} {key_name:<20} {keys}")
    return done(arguments, *lines, session=str(file.path), clients=rows)


# --- what they share


def _session_path(arguments: Namespace) -> Path:
    """Return the session file by its path, by the name of its bridge, or of the only server that runs here."""
    if arguments.session is not None:
        path: Path = arguments.session
        for each in () if is_there(path) else running_bridges():
            if each.name == str(path) and each.info is not None and each.info.file:
                return _file_of(each)
        return path  # opening it gives the reason if it is missing
    servers = []
    if arguments.bridge is None and arguments.control is None:
        servers = [each for each in running_bridges() if each.info is not None and each.info.role == "server"]
    try:
        bridge = servers[0] if len(servers) == 1 else chosen_bridge(arguments)
    except NoBridgeError as error:
        raise NoBridgeError(ClientCommandProblem.SESSION_UNKNOWN(problem=error)) from None
    if bridge.info is None or bridge.info.file is None:
        raise UsageError(f"{bridge.name} runs a session without a file: name the session file")
    return _file_of(bridge)


def _file_of(bridge: RunningBridge) -> Path:
    if bridge.file is None:
        raise UsageError(ClientCommandProblem.OF_ANOTHER_USER(name=bridge.name))
    return bridge.file


def _server_of(path: Path, control: Path | None) -> RunningBridge | None:
    """Return the bridge on this machine that runs a session file, or None."""
    if control is not None:
        return ask(control)
    found = [each for each in running_bridges() if each.runs(path)]
    # Another user's bridge that only says so must not hide the one that does.
    return min(found, key=lambda each: not each.trusted, default=None)


def _tell(arguments: Namespace, path: Path, command: Command[None], effect: str, effect_if_linked: str) -> str:
    """Apply a change that is saved already to the bridge that runs the session file.

    Returns:
        The effect in words, by whether the client was linked, or an empty string if no bridge runs the file.
    """
    bridge = _server_of(path, arguments.control)
    if bridge is None:
        return ""
    try:
        with attach(bridge.path, read_only=False) as engine:
            links = engine.snapshot().links
            linked = any(link.name == arguments.name and link.state is State.OK for link in links)
            result(engine.do(command))
    except EngineError as error:
        raise EngineError(ClientCommandProblem.BRIDGE_REFUSES(path=path, reason=error, name=bridge.name)) from None
    return f"{bridge.name} runs (pid {bridge.pid}): {effect_if_linked if linked else effect}"


def _links(path: Path, control: Path | None) -> dict[str, LinkSnapshot]:
    """Return the links of the bridge that runs a session file, by client name; empty without a bridge."""
    bridge = _server_of(path, control)
    if bridge is None:
        return {}
    try:
        with attach(bridge.path, read_only=True) as engine:
            return {link.name: link for link in engine.snapshot().links}
    except EngineError:  # the file alone answers, without states
        return {}


def _handed_out(arguments: Namespace, changed: ChangedFile, told: str) -> int:
    """Print the robot's session on standard output and advice on standard error."""
    file, client, key_at, key = changed
    text = client_files.robot_file(file.session, client, arguments.address)
    output: Path | None = arguments.output
    if output is not None:
        try:
            write_whole(output, text)
        except OSError as error:
            raise ClientError(f"{output}: cannot be written: {why_not_written(error, output)}") from None
    advice = client_files.copy_advice(client, key_at, output)
    mark = "" if key is None else fingerprint(key)
    if arguments.json:
        return done(
            arguments, name=client.name, session=str(file.path), key_file=None if key_at is None else str(key_at),
            fingerprint=mark, client_session=text, output=None if output is None else str(output), running=told or None,
        )  # fmt: skip
    if output is None:
        print_lines(text.removesuffix("\n"))
    if key is not None:
        print_error(f"{client.name}: key {key_at}, fingerprint {mark}")
    if arguments.saves:
        print_error(ClientEffect.SAVED(path=file.path, effect=told or ClientEffect.NOT_RUNNING()))
    print_error(f"for {client.name}: {advice}")
    return OK
