"""A new session: a form that writes a valid file, and makes or takes the key."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from textual import work
from textual.widgets import Button, Input

from rsb_bridge.config.files import typed_path
from rsb_bridge.config.keys import KeyFileError, fingerprint, key_path, read_key, write_key
from rsb_bridge.config.session_file import validate
from rsb_bridge.model.limits import CHANNEL, SAFE_DOMAIN
from rsb_bridge.model.session import Session
from rsb_console.screens.form import FormScreen
from rsb_console.screens.saving import save_asking
from rsb_console.session.saving import path_problem
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.form import Field, Spec

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from textual.app import ComposeResult

    from rsb_console.console import Console

YES_NO = (("yes", "yes"), ("no", "no"))
NUMBERS = ("server_port", "domain_id")
FIELDS = (
    Spec("role", "Role", "A client connects and says which topics cross; a server waits for clients.",
         options=(("client", "client (robot)"), ("server", "server (control PC)"))),
    Spec("name", "Name", "The same on both sides, like robot1."),
    Spec("server_ip", "Server", "IPv4, IPv6, host name, or Bluetooth MAC. On the server: what to bind (0.0.0.0: all)."),
    Spec("server_port", "Port", f"TCP and UDP port, or RFCOMM channel ({CHANNEL}): the same on both sides.", "49152"),
    Spec("domain_id", "Domain", f"ROS domain of this side, {SAFE_DOMAIN}. Empty: $ROS_DOMAIN_ID, else 0.",
         blank="$ROS_DOMAIN_ID"),
    Spec("use_name", "Prefix", "On the server, the client's topics have its name as a prefix: /robot1/scan. The "
         "same on both sides.", options=tuple(reversed(YES_NO))),
    Spec("use_encryption", "Encryption", "Without it everything crosses in the clear, and anyone may connect.",
         options=YES_NO),
    Spec("key_file", "Key file", "Beside the session file, or a path. It is made on one side and copied to the other.",
         edited=True),
    Spec("path", "Session file", "Where the session is saved.", edited=True),
)  # fmt: skip


class NewSession(NamedTuple):
    """A session and its file."""

    session: Session
    path: Path


class NewSessionScreen(FormScreen[NewSession]):
    """Write a session file. Gives it when it is written, and its key is there.

    Args:
        console: asks and tells.
        server_ip: to begin with.
    """

    def __init__(self, console: Console, server_ip: str = "") -> None:
        self.console = console
        self._fields = {spec.key: Field(spec) for spec in FIELDS}
        self._fields["server_ip"].value = server_ip
        super().__init__("New session", list(self._fields.values()), "Create")

    def compose_buttons(self) -> ComposeResult:
        """One more: a server by Bluetooth."""
        yield Button("Bluetooth…", id="bluetooth", compact=True)
        yield from super().compose_buttons()

    def check(self) -> None:
        """Fill in what follows from the rest, then look for problems."""
        values = self.form.values
        name = values["name"]
        encrypted = values["use_encryption"] == "yes"
        for key, suffix in (("path", "yaml"), ("key_file", "key")):
            control = self._fields[key].control
            assert isinstance(control, Input)
            control.placeholder = f"{name}.{suffix}" if name else ""
        self._fields["key_file"].display = encrypted
        super().check()
        about_key = self._about_key(self.result(self.form.values)) if encrypted and name else ""
        self._fields["key_file"].note.set_text(about_key)

    def _about_key(self, new: NewSession) -> str:
        """What will become of the key."""
        path = _key_path(new)
        if path_problem(str(path)):
            return ""
        if not path.exists():
            return "will be created: copy it to the other side"
        try:
            return f"exists, fingerprint {fingerprint(read_key(path))}"
        except KeyFileError:
            return ""

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        """The session file's own rules, and those of the files."""
        new = self.result(values)
        problems: dict[str, str] = {}
        for problem in validate(new.session):
            problems.setdefault(problem.location, problem.message)
        if not values["name"]:
            problems["name"] = "missing: give one"
        if not values["server_ip"]:
            problems["server_ip"] = "missing: give the server's address"
        if values["name"] or values["path"]:
            problems |= _at("path", path_problem(str(new.path)))
        else:
            problems["path"] = "missing: name the file"
        if new.session.use_encryption and "key_file" not in problems and "name" not in problems:
            problems |= _at("key_file", _key_problem(_key_path(new)))
        return problems

    def result(self, values: Mapping[str, str]) -> NewSession:
        """The session; not to be used while there are problems."""
        name = values["name"]
        data = {key: number(values[key]) for key in NUMBERS if values[key]}
        session = Session(
            name=name,
            role="server" if values["role"] == "server" else "client",
            server_ip=values["server_ip"],
            use_name=values["use_name"] == "yes",
            use_encryption=values["use_encryption"] == "yes",
            key_file=values.get("key_file") or f"{name}.key" if values["use_encryption"] == "yes" else None,
            **({"server_port": 0} | data),  # type: ignore[arg-type]  # what is no number is the rules' to refuse
        )
        return NewSession(session, typed_path(values["path"] or f"{name}.yaml"))

    @work(group=DIALOG)
    async def accept(self, result: NewSession) -> None:
        """Make the key if there is none, then write the file; ask before one is overwritten."""
        if not await save_asking(self.console, result.session, result.path):
            return
        if result.session.use_encryption and not _key_path(result).exists():
            try:
                key = write_key(_key_path(result))
            except KeyFileError as error:
                self.form.show_problems({"key_file": str(error)})
                return
            self.notify(
                f"{_key_path(result)}: fingerprint {fingerprint(key)}. Copy it to the other side.",
                title="A new key", markup=False, timeout=15,
            )  # fmt: skip
        self.dismiss(result)

    def press(self, button: str) -> None:
        if button == "bluetooth":
            self._pick_bluetooth()
        else:
            super().press(button)

    @work(group=DIALOG)
    async def _pick_bluetooth(self) -> None:
        from rsb_console.screens.bluetooth import BluetoothScreen  # noqa: PLC0415 -- needs D-Bus

        address = await self.console.ask(BluetoothScreen(self.console))
        if address:
            self._fields["server_ip"].value = address
            self._fields["server_port"].control.focus()


def _at(key: str, problem: str) -> dict[str, str]:
    return {key: problem} if problem else {}


def number(text: str) -> int | str:
    """A field's text as a session file has it. A text that is no number stays one, for the validation to refuse."""
    return int(text) if text.isdecimal() else text


def _key_path(new: NewSession) -> Path:
    assert new.session.key_file is not None
    return key_path(new.path.parent, new.session.key_file)


def _key_problem(path: Path) -> str:
    problem = path_problem(str(path))
    if problem or not path.exists():
        return problem
    try:
        read_key(path)
    except KeyFileError as error:
        return str(error)
    return ""
