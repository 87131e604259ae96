"""What each command does. Whatever needs ROS, Textual or D-Bus is imported by the command that uses it.

So help, keygen, check and import answer at once, on a machine with none of them.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from rsb_bridge.config.advice import advise, uninstalled_types
from rsb_bridge.config.keys import KeyFileError, fingerprint, key_path, read_key, write_key
from rsb_bridge.config.session_file import SessionError, dump, load, save
from rsb_bridge.config.thesis import import_bringup
from rsb_bridge.config.validation import domain_of, transport_of
from rsb_console.command.shell import FAILURE, NO_KEY, OK, USAGE, allow_many_descriptors, print_error, print_line

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from rsb_bridge.config.keys import Key
    from rsb_bridge.model.session import Session, Topic

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
    if not _can_draw(f"rsb-console run --no-ui {path or 'SESSION'}"):
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
    from rsb_console.command.remote import bridge_to_attach  # noqa: PLC0415 (not needed elsewhere)

    if not _can_draw("rsb-console status"):
        return USAGE
    bridge = bridge_to_attach(arguments)
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
        attach_to=bridge.path,
    )


def check(arguments: Namespace) -> int:
    """Print what a session would do, and what an operator should mend first; a missing key has its own exit code."""
    path: Path = arguments.session
    try:
        session = load(path)
    except SessionError as error:
        return _refuse(error)
    for line in _summary(session):
        print_line(line)
    keys = tuple(_keys(session, path))
    for warning in _warnings(session, keys):
        print_line(f"warning: {warning}")
    return NO_KEY if any(isinstance(key, KeyFileError) for key in keys) else OK


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
    if not arguments.no_ui and not _can_draw("rsb-console demo --no-ui"):
        return USAGE
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
        print_line(dump(session).removesuffix("\n"))
    for note in notes:
        print_error(note)
    return OK


def _warnings(session: Session, keys: Iterable[Key | KeyFileError]) -> Iterator[str]:
    """What is no mistake in a session, but what running it would warn of."""
    for key in keys:
        if isinstance(key, KeyFileError):
            yield f"{key}; without it the bridge does not start"
        else:
            yield from key.warnings
    yield from map(str, advise(session, os.environ.get("ROS_DOMAIN_ID")))
    yield from map(str, uninstalled_types(session))


def _keys(session: Session, path: Path) -> Iterator[Key | KeyFileError]:
    """Each key that a session needs, or why there is none."""
    if not session.use_encryption:
        return
    names = [client.key_file or session.key_file for client in session.clients] or [session.key_file]
    for name in dict.fromkeys(name for name in names if name is not None):
        try:
            yield read_key(key_path(path.parent, name))
        except KeyFileError as error:
            yield error


def _summary(session: Session) -> Iterator[str]:
    where = f"{session.server_ip} {'channel' if session.is_bluetooth else 'port'} {session.server_port}"
    yield f"{session.role} {session.name} {'at' if session.role == 'server' else 'to'} {where}, {_domain(session)}"
    yield f"encryption {'on' if session.use_encryption else 'OFF'}, {_prefix(session)}"
    for topic in session.topics:
        yield f"  {_route(topic, session)}"
    for client in session.clients:
        allowed = ", ".join(client.allow) or "all topics"
        prefix = "" if client.use_name is None else f", {_prefix_of(client.name, use_name=client.use_name)}"
        yield f"  accepts {client.name}: {allowed}{', not ' if client.deny else ''}{', '.join(client.deny)}{prefix}"
        for topic in client.topics:
            yield f"    proposes {_route(topic, session)}"
    if session.role == "server" and not session.clients:
        yield f"  accepts {session.name}: all topics"


def _domain(session: Session) -> str:
    try:
        domain = domain_of(session, os.environ.get("ROS_DOMAIN_ID"))
    except ValueError:  # which is a warning
        return "no ROS domain"
    return f"ROS domain {domain}{' (ROS_DOMAIN_ID, else 0)' if session.domain_id is None else ''}"


def _prefix(session: Session) -> str:
    if session.role == "client" and not session.use_name:
        return f"prefix /{session.name} where the server has use_name on"
    return _prefix_of("<name>" if session.clients else session.name, use_name=session.use_name)


def _prefix_of(name: str, *, use_name: bool) -> str:
    return f"prefix /{name}" if use_name else "no prefix"


def _route(topic: Topic, session: Session) -> str:
    transport = transport_of(topic, session)
    details = [f"type {topic.type}", f"qos {topic.qos}"]
    if topic.port is not None:
        details.append(f"port {topic.port}")
    compression = topic.compression or transport.compression
    if compression != "none":
        details.append(f"{compression} compression")
    if topic.remote_topic is not None:
        details.append(f"{topic.remote_topic} on the server")
    if topic.max_rate is not None:
        details.append(f"at most {topic.max_rate:g} Hz")
    if topic.expected_rate is not None:
        details.append(f"expected {topic.expected_rate:g} Hz")
    if topic.stale_after is not None:
        details.append(f"stale after {topic.stale_after:g} s" if topic.stale_after else "never stale")
    if topic.paused:
        details.append("paused")
    return f"{topic.direction} {topic.topic} over {transport.name}: {', '.join(details)}"


def _can_draw(instead: str) -> bool:
    """Whether the console has a terminal to draw on; says so where it hasn't."""
    reason = None
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        reason = "this isn't one (a pipe, a file, or ssh without -t)"
    elif os.environ.get("TERM", "") in ("", "dumb"):
        reason = "TERM says this one can't draw"
    if reason:
        print_error(f"the console needs a terminal, and {reason}. Without it: {instead}")
    return reason is None
