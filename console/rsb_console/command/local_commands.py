"""The commands `run`, `attach`, `keygen` and `import`; `doctor`, `demo` and `completion`, which start other modules.

Each command imports ROS, Textual or D-Bus itself if it needs them. So help, keygen, check and import answer at once,
even on a machine without them.
"""

from __future__ import annotations

import errno
import os
import sys
import termios
from typing import TYPE_CHECKING, TextIO

from rsb_bridge.config.files import is_there
from rsb_bridge.config.keys import (
    KeyFileError,
    fingerprint,
    write_key,
)
from rsb_bridge.config.session_file import SessionError, dump, load, save
from rsb_bridge.config.thesis import import_bringup
from rsb_bridge.model.wording import Wording
from rsb_console.command.check import print_mistakes
from rsb_console.command.shell import (
    FAILURE,
    OK,
    USAGE,
    allow_many_descriptors,
    print_error,
    print_line,
    print_lines,
)

if TYPE_CHECKING:
    from argparse import Namespace
    from pathlib import Path


_IMPORT_OPTIONS = {"key_file": "--key-file PATH, or --no-encryption", "server_port": "--port N"}  # by what they give


class LocalText(Wording):
    """Reports of the commands that attach to no bridge."""

    SESSION_MISSING = "--no-ui needs a session file: rsb-console run --no-ui SESSION"
    NEW_KEY = "{path}: a new key, fingerprint {fingerprint}. Copy the file to the other side, and keep it secret."
    IMPORTED = "written: {path}; `rsb-console check {path}` describes it"
    KEY_OPTION = "{field} is given with {option}"
    TERMINAL_GONE = "the console needs a terminal, and its own has gone. Without it: {instead}"
    NO_TERMINAL = (
        "the console needs a terminal, and this isn't one (a pipe, a file, or ssh without -t). Without it: {instead}"
    )
    PLAIN_TERMINAL = "the console needs a terminal, and TERM says this one can't draw. Without it: {instead}"


def run(arguments: Namespace) -> int:
    """Bridge a session, with the console or without."""
    allow_many_descriptors()
    path: Path | None = arguments.session
    if path is None and arguments.no_ui:
        print_error(LocalText.SESSION_MISSING())
        return USAGE
    try:
        session = load(path) if path is not None else None
    except SessionError as error:
        return print_mistakes(error)
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
    from rsb_console.command.console_command import run_console  # noqa: PLC0415 (needs Textual)

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
    from rsb_console.command.console_command import run_console  # noqa: PLC0415 (needs Textual)

    return run_console(
        None,
        readonly=arguments.readonly,
        ascii_only=arguments.ascii,
        theme=arguments.theme,
        mouse=not arguments.no_mouse,
        attach_to=bridge,
    )


def keygen(arguments: Namespace) -> int:
    """Create a key file and print its fingerprint, never the key."""
    path: Path = arguments.path
    try:
        key = write_key(path, force=arguments.force)
    except KeyFileError as error:
        print_error(str(error))
        return FAILURE
    print_line(LocalText.NEW_KEY(path=path, fingerprint=fingerprint(key)))
    return OK


def doctor(arguments: Namespace) -> int:
    """Examine this machine, and what a session needs of it."""
    from rsb_console.command.doctor import run_doctor  # noqa: PLC0415 (not needed elsewhere)

    return run_doctor(arguments.session, as_json=arguments.json)


def completion(arguments: Namespace) -> int:
    """Print the completion script for a shell."""
    # Not by `lazily`, which imports what attaches: each new shell waits for this.
    from rsb_console.command.completion import script  # noqa: PLC0415 (not needed elsewhere)

    return script(arguments)


def demo(arguments: Namespace) -> int:
    """Bridge two domains of this machine."""
    allow_many_descriptors()
    headless = f"rsb-console demo{' --fleet' if arguments.fleet else ''} --no-ui"
    if not arguments.no_ui and not can_draw(headless):
        return USAGE
    if arguments.fleet:
        from rsb_console.command.demo import run_fleet_demo  # noqa: PLC0415 (needs ROS)

        return run_fleet_demo(arguments.robots, ui=not arguments.no_ui, seconds=arguments.seconds)
    from rsb_console.command.demo import run_demo  # noqa: PLC0415 (needs ROS)

    return run_demo(ui=not arguments.no_ui, seconds=arguments.seconds)


def import_thesis(arguments: Namespace) -> int:
    """Convert the thesis's bringup.yaml to a session; differences go to standard error."""
    output: Path | None = arguments.output
    if output is not None and is_there(output) and not arguments.force:
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
            print_error(LocalText.KEY_OPTION(field=location, option=_IMPORT_OPTIONS[location]))
        return USAGE
    if output is None:
        print_lines(dump(session).removesuffix("\n"))
    for note in notes:
        print_error(note)
    if output is not None:
        print_line(LocalText.IMPORTED(path=output))
    return OK


def _has_hung_up(stream: TextIO | None) -> bool:
    try:
        termios.tcgetattr(stream)  # type: ignore[arg-type]
    except termios.error as error:
        # A terminal that has gone answers with EIO, a file or a pipe with ENOTTY.
        return bool(error.args[0] == errno.EIO)
    except (OSError, TypeError):  # it has no descriptor, or is closed, as for some services
        pass
    return False


def can_draw(instead: str) -> bool:
    """Whether the console has a terminal to draw on; print an error if not."""
    reason = None
    if not all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stdout)):
        gone = _has_hung_up(sys.stdin)
        reason = (LocalText.TERMINAL_GONE if gone else LocalText.NO_TERMINAL)(instead=instead)
    elif os.environ.get("TERM", "") in ("", "dumb"):
        reason = LocalText.PLAIN_TERMINAL(instead=instead)
    if reason:
        print_error(reason)
    return reason is None


COMMANDS = {"attach": attach}
