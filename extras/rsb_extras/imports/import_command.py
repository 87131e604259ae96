"""The command `import`."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from rsb_bridge.config.files import is_there
from rsb_bridge.config.keys import KeyFileError, write_key
from rsb_bridge.config.session_file import dump, save
from rsb_bridge.feature_api import SessionError, Wording, make_folder
from rsb_console.feature_console import FAILURE, OK, USAGE, print_error, print_line, print_lines
from rsb_extras.imports.importing import import_file
from rsb_extras.imports.other_bridges import Choices

if TYPE_CHECKING:
    from argparse import Namespace
    from pathlib import Path

    from rsb_extras.imports.other_bridges import Imported

_IMPORT_OPTIONS = {
    "name": "--name NAME",
    "key_file": "--key-file PATH, or --no-encryption",
    "server_port": "--port N",
    "server_ip": "connect: endpoints in that file",
}
"""How to give what a file leaves open, by the session's key."""


class ImportText(Wording):
    """Reports of the command."""

    IMPORTED = "written: {path}; `rsb-console check {path}` describes it"
    NEEDS_FOLDER = "it becomes {count} sessions: give a folder for them, with -o FOLDER"
    EXISTS = "{path}: exists already; --force replaces it"
    KEY_OPTION = "{field} is given with {option}"


def import_sessions(arguments: Namespace) -> int:
    """Convert another bridge's file to sessions; what differs goes to standard error, and into the sessions."""
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
            print_error(ImportText.KEY_OPTION(field=location, option=_IMPORT_OPTIONS[location]))
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
        print_line(ImportText.IMPORTED(path=path))
    return OK


def _write_imported(imported: Imported, output: Path, *, force: bool) -> list[Path]:
    """Write the sessions and their new keys, or nothing if one exists already; return the sessions' paths."""
    if several := len(imported.sessions) > 1:
        if is_there(output) and not output.is_dir():
            raise NotADirectoryError(f"{output}: {ImportText.NEEDS_FOLDER(count=len(imported.sessions))}")
        make_folder(output)
    paths = {stem: output / f"{stem}.yaml" if several else output for stem in imported.sessions}
    keys = [path for key in imported.new_keys if not is_there(path := output / key)]
    if not force and (there := [path for path in paths.values() if is_there(path)]):
        raise FileExistsError(ImportText.EXISTS(path=there[0]))
    for path in keys:
        write_key(path)
    for stem, session in imported.sessions.items():
        save(session, paths[stem], notes=imported.notes)
    return list(paths.values())
