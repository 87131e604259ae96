"""A form that imports another bridge's file."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from textual import on, work

from rsb_bridge.feature_api import SAFE_DOMAIN, Effect, SessionError, Wording, typed_path
from rsb_console.feature_console import DIALOG, ConfirmScreen, Field, FormScreen, Spec
from rsb_console.operations.session_operations import may_run
from rsb_console.screens.new_session import YES_NO, MissingField, at_field, number
from rsb_console.screens.save_screens import save_asking
from rsb_console.screens.session_files import (
    FileText,
    OpenedFile,
    is_file,
    is_path,
    no_suggestion,
    suggestions,
    yaml_files,
)
from rsb_console.session.saving import path_problem
from rsb_console.widgets.picker import PickField
from rsb_extras.imports.importing import import_file
from rsb_extras.imports.other_bridges import Choices

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping

    from rsb_bridge.feature_api import Session
    from rsb_bridge.model.session import Role
    from rsb_console.feature_console import Console, MainScreen

ROLES: dict[str, Role | None] = {"": None, "client": "client", "server": "server"}
MOST_PROBLEMS = 4
BRINGUP = Spec("bringup", "File", "Of ros2_socket_bridge (config/bringup.yaml) or zenoh-bridge-ros2dds.",
               blank="type to look for a file", edited=True)  # fmt: skip
IMPORT_FIELDS = (
    Spec("name", "Name", "As in the launch file (-name)."),
    Spec("role", "Role", "The session's role. A client's file can make a server's session, too.",
         options=(("", "as the file's node"), ("client", "client"), ("server", "server"))),
    Spec("server_port", "Port", "Of the server, as in its launch file (-p).", blank="the file's"),
    Spec("domain_id", "Domain", f"ROS domain of this side, {SAFE_DOMAIN}. Empty: $ROS_DOMAIN_ID, else 0.",
         blank="$ROS_DOMAIN_ID"),
    Spec("key_file", "Key file", "File with the launch file's key (-key), relative to the session's folder.", "key.txt",
         edited=True),
    Spec("use_name", "Prefix", "As in the launch file (-usename).", options=tuple(reversed(YES_NO))),
    Spec("use_encryption", "Encryption", "As in the launch file (-encrypt).", options=YES_NO),
    Spec("path", "Session file", "Where the session is saved.", edited=True),
)  # fmt: skip


class ImportProblem(Wording):
    """The reason why a form cannot import a file."""

    SEVERAL_SESSIONS = "several sessions: run `rsb-console import {path} -o FOLDER`"


class ImportScreen(FormScreen[OpenedFile]):
    """A form that imports and saves a session, and returns it if it should run (`may_run` as for a new session)."""

    def __init__(self, console: Console, may_run: Callable[[Path], Awaitable[bool]]) -> None:
        self.console = console
        self._may_run = may_run
        self._bringup = PickField(BRINGUP, is_path)
        super().__init__("Import", [self._bringup, *(Field(spec) for spec in IMPORT_FIELDS)], "Import")
        self._made: Session | None = None
        self._notes: list[str] = []

    def on_mount(self) -> None:
        files = yaml_files(Path.cwd(), Path.cwd() / "config")
        self._bringup.suggest(list(suggestions(files, "here")), no_suggestion)

    @on(Field.Changed)
    def _name_as_the_file(self, event: Field.Changed) -> None:
        """Suggest the file's name as the session's name unless the operator has typed one."""
        name = self.form.fields["name"]
        path = typed_path(self._bringup.value)
        if event.field is self._bringup and not name.touched and is_file(path):
            name.value = path.stem

    @on(PickField.Picked)
    def _picked(self, event: PickField.Picked) -> None:
        if event.suggestion is not None:
            self._bringup.value = event.suggestion.value
        self._bringup.touched = True
        self.check()
        self.form.fields["name"].control.focus()

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        problems = {} if values["name"] else {"name": MissingField.NAME()}
        problems |= at_field("path", path_problem(values["path"]))
        if not values["bringup"]:
            problems["bringup"] = FileText.MISSING()
        if not problems.keys() & {"bringup", "name"}:
            problems |= self._import(values)
        return problems

    def _import(self, values: Mapping[str, str]) -> dict[str, str]:
        """Make the session; show mistakes of the file at the file's field, others at their own."""
        encrypted = values["use_encryption"] == "yes"
        try:
            choices = Choices(
                name=values["name"],
                role=ROLES[values["role"]],
                server_port=number(values["server_port"]) if values["server_port"] else None,
                key_file=values["key_file"] or None if encrypted else None,
                use_name=values["use_name"] == "yes",
                use_encryption=encrypted,
                domain_id=number(values["domain_id"]) if values["domain_id"] else None,
            )
            imported = import_file(typed_path(values["bringup"]), choices)
        except SessionError as error:
            problems: dict[str, list[str]] = {}
            for problem in error.problems:
                key = problem.location if problem.location in values else "bringup"
                line = f"line {problem.line}: " if problem.line else ""
                problems.setdefault(key, []).append(problem.message if key == problem.location else f"{line}{problem}")
            for lines in problems.values():
                if (more := len(lines) - MOST_PROBLEMS) > 0:
                    lines[MOST_PROBLEMS:] = [f"and {more} more"]
            return {key: "\n".join(lines) for key, lines in problems.items()}
        if len(imported.sessions) > 1:
            return {"bringup": ImportProblem.SEVERAL_SESSIONS(path=values["bringup"])}
        (self._made,), self._notes = imported.sessions.values(), imported.notes
        return {}

    def result(self, values: Mapping[str, str]) -> OpenedFile:
        assert self._made is not None
        return OpenedFile(self._made, typed_path(values["path"]))

    @work(group=DIALOG)
    async def accept(self, result: OpenedFile) -> None:
        """Save the session, show the differences, and ask whether to run it."""
        if await save_asking(self.console, result.session, result.path):
            summary = "All was imported."
            if self._notes:
                summary = "\n".join(["What differs from the other bridge:", *self._notes])
            question = ConfirmScreen(f"Imported. Run {result.path.name}?", summary, "Run", Effect.MOVES)
            if await self.console.ask(question) and await self._may_run(result.path):
                self.dismiss(result)


async def import_session(screen: MainScreen) -> None:
    """Import a file of another bridge."""
    console = screen.console
    imported = await console.ask(ImportScreen(console, partial(may_run, console)))
    if imported is not None:
        await console.run_session(imported.session, imported.path)
