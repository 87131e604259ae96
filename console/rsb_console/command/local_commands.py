"""The commands `run`, `attach`, `keygen` and `completion`.

Each command imports ROS, Textual or D-Bus itself if it needs them. So help, keygen and check answer at once, even on a
machine without them.
"""

from __future__ import annotations

import errno
import os
import sys
import termios
from typing import TYPE_CHECKING, Any

from rsb_bridge.config.keys import KeyFileError, fingerprint, write_key
from rsb_bridge.config.session_file import SessionError, load
from rsb_bridge.model.wording import Wording
from rsb_console.command.check import print_mistakes
from rsb_console.command.shell import FAILURE, OK, USAGE, allow_many_descriptors, print_error, print_line

if TYPE_CHECKING:
    from argparse import Namespace
    from pathlib import Path


class LocalText(Wording):
    """Reports of the commands that attach to no bridge."""

    SESSION_MISSING = "--no-ui needs a session file: rsb-console run --no-ui SESSION"
    NEW_KEY = "{path}: a new key, fingerprint {fingerprint}. Copy the file to the other side, and keep it secret."
    TERMINAL_GONE = "the console needs a terminal, and its own has gone. Without it: {instead}"
    NO_TERMINAL = (
        "the console needs a terminal, and this isn't one (a pipe, a file, or ssh without -t). Without it: {instead}"
    )
    PLAIN_TERMINAL = "the console needs a terminal, and TERM says this one can't draw. Without it: {instead}"


def run(arguments: Namespace) -> int:
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
    return _open_console(arguments, path, on_hangup=arguments.on_hangup, control=arguments.control)


def attach(arguments: Namespace) -> int:
    from rsb_console.command.target import what_to_attach  # noqa: PLC0415 (not needed elsewhere)

    if not can_draw("rsb-console status"):
        return USAGE
    return _open_console(arguments, None, attach_to=what_to_attach(arguments))


def _open_console(arguments: Namespace, path: Path | None, **options: Any) -> int:
    from rsb_console.command.console_command import run_console  # noqa: PLC0415 (needs Textual)

    return run_console(
        path,
        readonly=arguments.readonly,
        ascii_only=arguments.ascii,
        theme=arguments.theme,
        mouse=not arguments.no_mouse,
        **options,
    )


def keygen(arguments: Namespace) -> int:
    path: Path = arguments.path
    try:
        key = write_key(path, force=arguments.force)
    except KeyFileError as error:
        print_error(str(error))
        return FAILURE
    print_line(LocalText.NEW_KEY(path=path, fingerprint=fingerprint(key)))
    return OK


def completion(arguments: Namespace) -> int:
    from rsb_console.command.completion import script  # noqa: PLC0415 (not needed elsewhere)

    return script(arguments)


def can_draw(instead: str) -> bool:
    """Whether the console has a terminal to draw on; print an error if not."""
    if not all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stdout)):
        problem = LocalText.NO_TERMINAL
        try:
            termios.tcgetattr(sys.stdin)
        except termios.error as error:
            # A terminal that has gone answers with EIO, a file or a pipe with ENOTTY.
            if error.args[0] == errno.EIO:
                problem = LocalText.TERMINAL_GONE
        except (OSError, TypeError):  # it has no descriptor, or is closed, as for some services
            pass
    elif os.environ.get("TERM", "") in ("", "dumb"):
        problem = LocalText.PLAIN_TERMINAL
    else:
        return True
    print_error(problem(instead=instead))
    return False
