"""A new session: a form that writes a valid file and makes or takes the key."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from textual import work
from textual.widgets import Button, Input

from rsb_bridge.config.files import is_there, typed_path
from rsb_bridge.config.keys import KeyFileError, fingerprint, key_path, read_key, write_key
from rsb_bridge.config.session_file import SessionFile, validate
from rsb_bridge.model.limits import CHANNEL, DEFAULT_PORT, SAFE_DOMAIN
from rsb_bridge.model.session import Client, Session, session_keys
from rsb_bridge.model.wording import Wording
from rsb_console.screens.clients_screen import HandoutScreen, words
from rsb_console.screens.save_screens import save_asking
from rsb_console.screens.session_files import FileText
from rsb_console.session.client_files import handed_out, key_file_name
from rsb_console.session.saving import path_problem
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.form import Field, FormScreen, Spec

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping
    from pathlib import Path

    from textual.app import ComposeResult

    from rsb_console.console_api import Console

HANDOUT = "What the clients need"
YES_NO = (("yes", "yes"), ("no", "no"))
NUMBERS = ("server_port", "domain_id")
FIELDS = (
    Spec("role", "Role", "A client connects and lists the topics; a server waits for clients.",
         options=(("client", "client (robot)"), ("server", "server (control PC)"))),
    Spec("name", "Name", "The same on both sides, like robot1."),
    Spec(
        "server_ip",
        "Server",
        "IPv4, IPv6, host name or Bluetooth MAC; several: the preferred one first. On the server: the address to bind.",
    ),
    Spec("server_port", "Port", f"TCP and UDP port, or RFCOMM channel ({CHANNEL}): the same on both sides.",
         str(DEFAULT_PORT)),
    Spec("domain_id", "Domain", f"ROS domain of this side, {SAFE_DOMAIN}. Empty: $ROS_DOMAIN_ID, else 0.",
         blank="$ROS_DOMAIN_ID"),
    Spec("use_name", "Prefix", "On the server, the client's topics have its name as a prefix: /robot1/scan. The "
         "same on both sides.", options=tuple(reversed(YES_NO))),
    Spec("clients", "Clients", "The robots that the server accepts: robot1, robot2. Each gets its own key. Empty: "
         "one client, with the server's name and key.", blank="one, of the server's name"),
    Spec("use_encryption", "Encryption", "Without it all data crosses unencrypted, and anyone may connect.",
         options=YES_NO),
    Spec("key_file", "Key file", "In the session's folder, or a path. Created on one side, then copied to the other.",
         edited=True),
    Spec("path", "Session file", "Where the session is saved.", edited=True),
)  # fmt: skip


class MissingField(Wording):
    """Fields that must be filled in."""

    NAME = "missing: give one"
    PORT = "missing: give the port"


_LISTS = ("clients[", "server_ip[")  # whose entries have one field


class NewSession(NamedTuple):
    session: Session
    path: Path


class NewSessionScreen(FormScreen[NewSession]):
    """A form that writes a session file and its key, and returns the file.

    Args:
        may_run: asks whether to run the session of a file instead of the present one; if not, the form stays.
        server_ip: first text of the field.
    """

    def __init__(self, console: Console, may_run: Callable[[Path], Awaitable[bool]], server_ip: str = "") -> None:
        self.console = console
        self._may_run = may_run
        self._fields = {spec.key: Field(spec) for spec in FIELDS}
        self._fields["server_ip"].value = server_ip
        super().__init__("New session", list(self._fields.values()), "Create")

    def compose_buttons(self) -> ComposeResult:
        yield Button("Bluetooth…", id="bluetooth", compact=True)
        yield from super().compose_buttons()

    def check(self) -> None:
        """Fill in derived values, then check for problems."""
        name, encrypted = self.form.values["name"], self.form.values["use_encryption"] == "yes"
        for key, suffix in (("path", "yaml"), ("key_file", "key")):
            control = self._fields[key].control
            assert isinstance(control, Input)
            control.placeholder = f"{name}.{suffix}" if name else ""
        # Before the check: the values of a hidden field do not count.
        self._fields["clients"].display = self.form.values["role"] == "server"
        self._fields["key_file"].display = encrypted and not self.result(self.form.values).session.listed_clients
        super().check()
        new = self.result(self.form.values)
        about = [(path.name, _about_key(path)) for path in _key_paths(new)] if name else []
        if new.session.listed_clients:
            of_client, of_clients = "", "\n".join(f"{file} {text}" for file, text in about if text)
        else:
            of_client, of_clients = next((text for _, text in about), ""), ""
        self._fields["key_file"].note.set_text(of_client)
        self._fields["clients"].note.set_text(of_clients)

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        new = self.result(values)
        problems: dict[str, str] = {}
        for problem in validate(new.session):
            location = problem.location.partition("[")[0] if problem.location.startswith(_LISTS) else problem.location
            if location in session_keys():  # the address asks for it, and it is written in the file
                location = "server_ip"
            problems.setdefault(location, problem.message)
        names = [client.name for client in new.session.listed_clients]
        if len(set(names)) < len(names):
            problems["clients"] = f"{next(each for each in names if names.count(each) > 1)} occurs twice"
        if not values["name"]:
            problems["name"] = MissingField.NAME()
        if not values["server_ip"]:
            problems["server_ip"] = "missing: give the server's address"
        if not values["server_port"]:
            problems["server_port"] = MissingField.PORT()
        if values["name"] or values["path"]:
            problems |= at_field("path", path_problem(str(new.path)))
        else:
            problems["path"] = FileText.MISSING()
        # Names of key files follow from these, and would be reported as a second mistake.
        if not {"key_file", "name", "clients"} & problems.keys():
            for path in _key_paths(new):
                problems |= at_field("clients" if new.session.listed_clients else "key_file", _key_problem(path))
        return problems

    def result(self, values: Mapping[str, str]) -> NewSession:
        """Return the session; valid only without problems."""
        name = values["name"]
        encrypted = values["use_encryption"] == "yes"
        names = words(values.get("clients", "")) if values["role"] == "server" else ()
        hosts = words(values["server_ip"])
        data = {key: number(values[key]) for key in NUMBERS if values[key]}
        session = Session(
            name=name,
            role="server" if values["role"] == "server" else "client",
            server_ip=hosts[0] if len(hosts) == 1 else hosts,
            use_name=values["use_name"] == "yes",
            use_encryption=encrypted,
            key_file=values.get("key_file") or f"{name}.key" if encrypted and not names else None,
            clients=tuple(Client(each, key_file_name(each) if encrypted else None) for each in names) or None,
            **({"server_port": 0} | data),  # type: ignore[arg-type]  # what is no number is the rules' to refuse
        )
        return NewSession(session, typed_path(values["path"] or f"{name}.yaml"))

    @work(group=DIALOG)
    async def accept(self, result: NewSession) -> None:
        """Write the file and create missing keys; ask before a file is overwritten."""
        # The file first: without permission to overwrite it, no keys are made either.
        if not await save_asking(self.console, result.session, result.path):
            return
        for path in _key_paths(result):
            if path.exists():
                continue
            try:
                key = write_key(path)
            except KeyFileError as error:
                self.form.show_problems({"clients" if result.session.listed_clients else "key_file": str(error)})
                return
            if not result.session.listed_clients:
                message = f"{path}: fingerprint {fingerprint(key)}. Copy it to the other side."
                self.notify(message, title="A new key", markup=False, timeout=15)
        if result.session.listed_clients:
            handed = handed_out(SessionFile(result.path, "", result.session))
            await self.console.ask(HandoutScreen(HANDOUT, handed))
        if await self._may_run(result.path):
            self.dismiss(result)

    def press(self, button: str) -> None:
        if button == "bluetooth":
            self._pick_bluetooth()
        else:
            super().press(button)

    @work(group=DIALOG)
    async def _pick_bluetooth(self) -> None:
        from rsb_console.screens.bluetooth_screen import BluetoothScreen  # noqa: PLC0415 -- needs D-Bus

        address = await self.console.ask(BluetoothScreen(self.console))
        if address:
            self._fields["server_ip"].value = address
            self._fields["server_port"].control.focus()


def at_field(key: str, problem: str) -> dict[str, str]:
    return {key: problem} if problem else {}


def number(text: str) -> int | str:
    """Convert a field's text as a session file does; text in place of a number stays, for the validation to refuse."""
    return int(text) if text.isdecimal() else text


def _key_paths(new: NewSession) -> list[Path]:
    """Return the paths of the session's keys, existing or not."""
    names = [client.key_file for client in new.session.listed_clients] or [new.session.key_file]
    return [key_path(new.path.parent, name) for name in names if name is not None]


def _about_key(path: Path) -> str:
    if path_problem(str(path)):
        return ""
    if not is_there(path):
        return "will be created: copy it to the other side"
    try:
        return f"exists, fingerprint {fingerprint(read_key(path))}"
    except KeyFileError:
        return ""


def _key_problem(path: Path) -> str:
    problem = path_problem(str(path))
    if problem or not path.exists():
        return problem
    try:
        read_key(path)
    except KeyFileError as error:
        return str(error)
    return ""
