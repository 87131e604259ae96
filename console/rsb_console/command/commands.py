"""What each command does. Whatever needs ROS, Textual or D-Bus is imported by the command that uses it.

So help, keygen, check and import answer at once, on a machine with none of them.
"""

from __future__ import annotations

import errno
import os
import sys
import termios
import time
from itertools import chain
from typing import TYPE_CHECKING

from rsb_bridge.config.advice import advise, uninstalled_types
from rsb_bridge.config.fault_command import fault_command_warnings
from rsb_bridge.config.granted_operators import operator_key_problem
from rsb_bridge.config.keys import (
    Key,
    KeyFileError,
    fingerprint,
    key_files_by_client,
    key_path,
    key_users,
    key_warnings,
    read_key,
    shared_key_problem,
    write_key,
    written,
)
from rsb_bridge.config.session_file import SessionError, demand_places, dump, load, save
from rsb_bridge.config.thesis import import_bringup
from rsb_console.command.check_report import hints, rights, summary
from rsb_console.command.shell import (
    FAILURE,
    NO_KEY,
    OK,
    USAGE,
    allow_many_descriptors,
    print_error,
    print_line,
    print_lines,
)

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from rsb_bridge.model.session import Session

_IMPORT_OPTIONS = {"key_file": "--key-file PATH, or --no-encryption", "server_port": "--port N"}  # by what they give


def run(arguments: Namespace) -> int:
    """Bridge a session, with the console or without."""
    allow_many_descriptors()
    path: Path | None = arguments.session
    if path is None and arguments.no_ui:
        print_error("--no-ui needs a session file: rsb-console run --no-ui SESSION")
        return USAGE
    try:
        session = load(path) if path is not None else None
    except SessionError as error:
        return _refuse(error)
    if arguments.no_ui and path is not None and session is not None:
        from rsb_console.command.headless import run_headless  # noqa: PLC0415 (needs ROS)

        return run_headless(
            path,
            session,
            log_format=arguments.log_format,
            on_hangup=arguments.on_hangup,
            status_every=arguments.status_every,
            control=arguments.control,
        )
    if not can_draw(f"rsb-console run --no-ui {path or 'SESSION'}"):
        return USAGE
    from rsb_console.command.console import run_console  # noqa: PLC0415 (needs Textual)

    return run_console(
        path,
        readonly=arguments.readonly,
        ascii_only=arguments.ascii,
        theme=arguments.theme,
        on_hangup=arguments.on_hangup,
        mouse=not arguments.no_mouse,
        control=arguments.control,
    )


def attach(arguments: Namespace) -> int:
    """Open the console on a bridge that runs already."""
    from rsb_console.command.target import what_to_attach  # noqa: PLC0415 (not needed elsewhere)

    if not can_draw("rsb-console status"):
        return USAGE
    bridge = what_to_attach(arguments)
    if isinstance(bridge, int):
        return bridge
    from rsb_console.command.console import run_console  # noqa: PLC0415 (needs Textual)

    return run_console(
        None,
        readonly=arguments.readonly,
        ascii_only=arguments.ascii,
        theme=arguments.theme,
        on_hangup="stop",
        mouse=not arguments.no_mouse,
        attach_to=bridge,
    )


def check(arguments: Namespace) -> int:
    """Print what a session would do, and what an operator should mend first; a missing key has its own exit code."""
    path: Path = arguments.session
    try:
        session = load(path)
    except SessionError as error:
        return _refuse(error)
    for line in summary(session, demand_places(path)):
        print_line(line)
    for line in chain(rights(session), hints(session)):
        print_line(line)
    keys = dict(_keys(session, path))
    for line in _key_lines(session, keys):
        print_line(line)
    for warning in chain(_warnings(session, keys), fault_command_warnings(session, path)):
        print_line(f"warning: {warning}")
    if problem := _shared_keys(session, keys):
        print_error(f"the bridge does not start: {problem}")
        return USAGE
    return NO_KEY if any(isinstance(key, KeyFileError) for key in keys.values()) else OK


def _refuse(error: SessionError) -> int:
    """Say what is wrong with a session file: with the file as a whole, or in its lines."""
    in_lines = any(problem.line for problem in error.problems)
    print_error(f"a session file with mistakes\n{error}" if in_lines else str(error))
    return USAGE


def keygen(arguments: Namespace) -> int:
    """Make a key file, and print the fingerprint; never the key."""
    path: Path = arguments.path
    try:
        key = write_key(path, force=arguments.force)
    except KeyFileError as error:
        print_error(str(error))
        return FAILURE
    print_line(
        f"{path}: a new key, fingerprint {fingerprint(key)}. Copy the file to the other side, and keep it secret."
    )
    return OK


def bt_scan(arguments: Namespace) -> int:
    """List Bluetooth adapters and their busy channels."""
    from rsb_console.command.bt_scan import run_bt_scan  # noqa: PLC0415 (needs D-Bus)

    return run_bt_scan(arguments.adapter, arguments.json)


def service(arguments: Namespace) -> int:
    """Write, show or remove the systemd unit of a session."""
    from rsb_console.command.service import run as run_service  # noqa: PLC0415 (not needed elsewhere)

    return run_service(arguments)


def demo(arguments: Namespace) -> int:
    """Bridge two domains of this machine."""
    allow_many_descriptors()
    headless = f"rsb-console demo{' --fleet' if arguments.fleet else ''} --no-ui"
    if not arguments.no_ui and not can_draw(headless):
        return USAGE
    if arguments.fleet:
        from rsb_console.command.demo_fleet import run_fleet_demo  # noqa: PLC0415 (needs ROS)

        return run_fleet_demo(arguments.robots, ui=not arguments.no_ui, seconds=arguments.seconds)
    from rsb_console.command.demo import run_demo  # noqa: PLC0415 (needs ROS)

    return run_demo(ui=not arguments.no_ui, seconds=arguments.seconds)


def import_thesis(arguments: Namespace) -> int:
    """Write a session made of the thesis's bringup.yaml; what became different goes to standard error."""
    output: Path | None = arguments.output
    if output is not None and output.exists() and not arguments.force:
        print_error(f"{output}: exists already; --force replaces it")
        return FAILURE
    key_file = arguments.key_file
    if key_file is not None and output is not None and not key_file.is_absolute():
        key_file = os.path.relpath(key_file, output.parent)  # a session names its key relative to itself
    try:
        session, notes = import_bringup(
            arguments.bringup,
            name=arguments.name,
            role=arguments.role,
            server_port=arguments.port,
            key_file=None if key_file is None else str(key_file),
            use_name=arguments.use_name,
            use_encryption=not arguments.no_encryption,
            domain_id=arguments.domain_id,
        )
        if output is not None:
            save(session, output)
    except SessionError as error:
        print_error(f"not imported\n{error}")
        missing = {each.location for each in error.problems if not each.line} & _IMPORT_OPTIONS.keys()
        for location in sorted(missing):  # those in the file have its line
            print_error(f"{location} is given with {_IMPORT_OPTIONS[location]}")
        return USAGE
    if output is None:
        print_lines(dump(session).removesuffix("\n"))
    for note in notes:
        print_error(note)
    return OK


def _warnings(session: Session, keys: Mapping[str, Key | KeyFileError]) -> Iterator[str]:
    """What is no mistake in a session, but what running it would warn of."""
    yield from (
        f"{key}; without it the bridge does not start" for key in keys.values() if isinstance(key, KeyFileError)
    )
    valid = {
        name: tuple(key for file in files if isinstance(key := keys.get(file), Key))
        for name, files in key_files_by_client(session).items()
    }
    operators = {
        f"operator {each.name}": (key,) for each in session.operators if isinstance(key := keys.get(each.key_file), Key)
    }
    yield from key_warnings(valid | operators, time.time())
    yield from map(str, advise(session, os.environ.get("ROS_DOMAIN_ID")))
    yield from map(str, uninstalled_types(session))


def _key_lines(session: Session, keys: Mapping[str, Key | KeyFileError]) -> Iterator[str]:
    """Whose each key is, and since when it has been in its file."""
    users = key_users(session)
    for file, key in keys.items():
        if isinstance(key, Key):
            yield f"key {file}, for {users[file]}: {fingerprint(key)}, written {written(key, time.time())}"


def _shared_keys(session: Session, keys: Mapping[str, Key | KeyFileError]) -> str:
    """Why clients' or operators' keys are refused. Where a key cannot be read, its file stands for it."""

    def read(file: str) -> Key | str:
        return key if isinstance(key := keys[file], Key) else file

    files = key_files_by_client(session).items() if session.use_encryption else ()
    of_links = {name: [*map(read, of_client)] for name, of_client in files}
    shared = shared_key_problem(session, of_links) if session.role == "server" else ""
    return shared or operator_key_problem({each.name: read(each.key_file) for each in session.operators}, of_links)


def _keys(session: Session, path: Path) -> Iterator[tuple[str, Key | KeyFileError]]:
    """Each key that a session needs, by its file, or why there is none."""
    of_links = chain.from_iterable(key_files_by_client(session).values()) if session.use_encryption else ()
    for name in dict.fromkeys([*of_links, *(each.key_file for each in session.operators)]):
        try:
            yield name, read_key(key_path(path.parent, name))
        except KeyFileError as error:
            yield name, error


def _has_hung_up(terminal: int) -> bool:
    try:
        termios.tcgetattr(terminal)
    except termios.error as error:
        return bool(error.args[0] == errno.EIO)
    return False


def can_draw(instead: str) -> bool:
    """Whether the console has a terminal to draw on; says so where it hasn't."""
    reason = None
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        gone = _has_hung_up(sys.stdin.fileno())
        reason = "its own has gone" if gone else "this isn't one (a pipe, a file, or ssh without -t)"
    elif os.environ.get("TERM", "") in ("", "dumb"):
        reason = "TERM says this one can't draw"
    if reason:
        print_error(f"the console needs a terminal, and {reason}. Without it: {instead}")
    return reason is None
