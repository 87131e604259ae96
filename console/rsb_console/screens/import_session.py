"""Import a thesis bringup.yaml: what the launch file said beside it is asked for here."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from textual import on, work

from rsb_bridge.config.files import typed_path
from rsb_bridge.config.session_file import SessionError
from rsb_bridge.config.thesis import import_bringup
from rsb_bridge.model.limits import SAFE_DOMAIN
from rsb_console.screens.confirm import ConfirmScreen
from rsb_console.screens.form import FormScreen
from rsb_console.screens.new_session import YES_NO, number
from rsb_console.screens.saving import save_asking
from rsb_console.screens.session_files import Opened, is_file, is_path, no_suggestion, suggestions, yaml_files
from rsb_console.session.saving import path_problem
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.form import Field, Spec
from rsb_console.widgets.picker import PickField

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping

    from rsb_bridge.model.session import Role, Session
    from rsb_console.console import Console

ROLES: dict[str, Role | None] = {"": None, "client": "client", "server": "server"}
MOST_PROBLEMS = 4
BRINGUP = Spec("bringup", "File", "config/bringup.yaml of ros2_socket_bridge: a client's or a server's.",
               blank="type to look for a file", edited=True)  # fmt: skip
FIELDS = (
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


class ImportScreen(FormScreen[Opened]):
    """Import and save; gives the session if it is to be run.

    Args:
        console: asks and tells.
        may_run: whether the operator agrees to run the session of a file instead of the present one; if not, the form
            stays.
    """

    def __init__(self, console: Console, may_run: Callable[[Path], Awaitable[bool]]) -> None:
        self.console = console
        self._may_run = may_run
        self._bringup = PickField(BRINGUP, is_path)
        super().__init__("Import", [self._bringup, *(Field(spec) for spec in FIELDS)], "Import")
        self._made: Session | None = None
        self._notes: list[str] = []

    def on_mount(self) -> None:
        super().on_mount()
        files = yaml_files(Path.cwd(), Path.cwd() / "config")
        self._bringup.suggest(list(suggestions(files, "here")), no_suggestion)

    @on(Field.Changed)
    def _name_as_the_file(self, event: Field.Changed) -> None:
        """The file's name is a name to begin with, unless the operator has given one."""
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
        problems = {}
        if not values["name"]:
            problems["name"] = "missing: give one"
        if problem := path_problem(values["path"]):
            problems["path"] = problem
        if not values["bringup"]:
            problems["bringup"] = "missing: name the file"
        if not problems.keys() & {"bringup", "name"}:
            problems |= self._import(values)
        return problems

    def _import(self, values: Mapping[str, str]) -> dict[str, str]:
        """Make the session; what is wrong in the file is about the file, the rest about its field."""
        encrypted = values["use_encryption"] == "yes"
        try:
            self._made, self._notes = import_bringup(
                typed_path(values["bringup"]),
                name=values["name"],
                role=ROLES[values["role"]],
                server_port=number(values["server_port"]) if values["server_port"] else None,
                key_file=values["key_file"] or None if encrypted else None,
                use_name=values["use_name"] == "yes",
                use_encryption=encrypted,
                domain_id=number(values["domain_id"]) if values["domain_id"] else None,
            )
        except SessionError as error:
            problems: dict[str, list[str]] = {}
            for problem in error.problems:
                key = problem.location if problem.location in values else "bringup"
                line = f"line {problem.line}: " if problem.line else ""
                problems.setdefault(key, []).append(problem.message if key == problem.location else f"{line}{problem}")
            return {key: _few(lines) for key, lines in problems.items()}
        return {}

    def result(self, values: Mapping[str, str]) -> Opened:
        assert self._made is not None
        return Opened(self._made, typed_path(values["path"]))

    @work(group=DIALOG)
    async def accept(self, result: Opened) -> None:
        """Save it, say what is different now, and ask whether to run it."""
        if await save_asking(self.console, result.session, result.path):
            summary = "\n".join(
                ["What differs from the thesis's bridge:", *self._notes] if self._notes else ["All was imported."]
            )
            question = ConfirmScreen(f"Imported. Run {result.path.name}?", summary, "Run")
            if await self.console.ask(question) and await self._may_run(result.path):
                self.dismiss(result)


def _few(lines: list[str]) -> str:
    more = len(lines) - MOST_PROBLEMS
    return "\n".join(lines[:MOST_PROBLEMS] + ([f"and {more} more"] if more > 0 else []))
