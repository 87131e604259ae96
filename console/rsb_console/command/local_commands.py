"""The commands `run`, `attach`, `keygen` and `import`; `demo` and `completion`, which start other modules.

Each command imports ROS, Textual or D-Bus itself if it needs them. So help, keygen, check and import answer at once,
even on a machine without them.
"""

from __future__ import annotations

import errno
import os
import sys
import termios
from typing import TYPE_CHECKING, Any

from rsb_bridge.config.files import is_there, make_folder
from rsb_bridge.config.keys import KeyFileError, fingerprint, write_key
from rsb_bridge.config.session_file import SessionError, dump, load, save
from rsb_bridge.model.wording import Wording
from rsb_console.command.check import print_mistakes
from rsb_console.command.shell import FAILURE, OK, USAGE, allow_many_descriptors, print_error, print_line, print_lines

if TYPE_CHECKING:
    from argparse import Namespace
    from pathlib import Path

    from rsb_bridge.config.imports.other_bridges import Imported


_IMPORT_OPTIONS = {
    "name": "--name NAME",
    "key_file": "--key-file PATH, or --no-encryption",
    "server_port": "--port N",
    "server_ip": "connect: endpoints in that file",
}
"""How to give what a file leaves open, by the session's key."""


class LocalText(Wording):
    """Reports of the commands that attach to no bridge."""

    SESSION_MISSING = "--no-ui needs a session file: rsb-console run --no-ui SESSION"
    NEW_KEY = "{path}: a new key, fingerprint {fingerprint}. Copy the file to the other side, and keep it secret."
    IMPORTED = "written: {path}; `rsb-console check {path}` describes it"
    NEEDS_FOLDER = "it becomes {count} sessions: give a folder for them, with -o FOLDER"
    EXISTS = "{path}: exists already; --force replaces it"
    KEY_OPTION = "{field} is given with {option}"
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


def demo(arguments: Namespace) -> int:
    allow_many_descriptors()
    if not arguments.no_ui and not can_draw("rsb-console demo --no-ui"):
        return USAGE
    from rsb_console.command.demo import run_demo  # noqa: PLC0415 (needs ROS)

    return run_demo(ui=not arguments.no_ui, seconds=arguments.seconds)


def import_sessions(arguments: Namespace) -> int:
    """Convert another bridge's file to sessions; what differs goes to standard error, and into the sessions."""
    from rsb_bridge.config.imports.importing import import_file  # noqa: PLC0415 (not needed elsewhere)
    from rsb_bridge.config.imports.other_bridges import Choices  # noqa: PLC0415 (not needed elsewhere)

    output: Path | None = arguments.output
    key_file = arguments.key_file
    if key_file is not None and output is not None and not key_file.is_absolute():
        # a session names its key relative to itself
        key_file = os.path.relpath(key_file, output if output.is_dir() else output.parent)
    choices = Choices(
        name=arguments.name,
        role=arguments.role,
        server_port=arguments.port,
        key_file=None if key_file is None else str(key_file),
        use_name=arguments.use_name,
        use_encryption=not arguments.no_encryption,
        domain_id=arguments.domain_id,
    )
    try:
        imported = import_file(arguments.file, choices)
        written = [] if output is None else _write_imported(imported, output, force=arguments.force)
    except SessionError as error:
        print_error(f"not imported\n{error}")
        missing = {each.location for each in error.problems if not each.line} & _IMPORT_OPTIONS.keys()
        for location in sorted(missing):  # those in the file have its line
            print_error(LocalText.KEY_OPTION(field=location, option=_IMPORT_OPTIONS[location]))
        return USAGE
    except (FileExistsError, NotADirectoryError, KeyFileError) as error:
        print_error(str(error))
        return FAILURE
    if output is None:
        texts = [
            dump(session, [*([f"{stem}.yaml"] if stem else []), *imported.notes])
            for stem, session in imported.sessions.items()
        ]
        print_lines("---\n".join(texts).removesuffix("\n"))
    for note in imported.notes:
        print_error(note)
    for path in written:
        print_line(LocalText.IMPORTED(path=path))
    return OK


def _write_imported(imported: Imported, output: Path, *, force: bool) -> list[Path]:
    """Write the sessions and their new keys, or nothing if one exists already; return the sessions' paths."""
    if several := len(imported.sessions) > 1:
        if is_there(output) and not output.is_dir():
            raise NotADirectoryError(f"{output}: {LocalText.NEEDS_FOLDER(count=len(imported.sessions))}")
        make_folder(output)
    paths = {stem: output / f"{stem}.yaml" if several else output for stem in imported.sessions}
    keys = [path for key in imported.new_keys if not is_there(path := output / key)]
    if not force and (there := [path for path in paths.values() if is_there(path)]):
        raise FileExistsError(LocalText.EXISTS(path=there[0]))
    for path in keys:
        write_key(path)
    for stem, session in imported.sessions.items():
        save(session, paths[stem], notes=imported.notes)
    return list(paths.values())


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
