"""`rsb-console service`: writes, shows and removes the systemd unit of a session, and says what to run then."""

from __future__ import annotations

import os
import pwd
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.files import replace_file
from rsb_bridge.config.session_file import SessionError, load
from rsb_bridge.model.shortage import why_not_written
from rsb_console.command.shell import FAILURE, OK, USAGE, print_error, print_line, print_lines
from rsb_console.session.service_unit import KEPT_VARIABLES, MARK, Service, unit_name

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Mapping

_SYSTEM_UNITS = Path("/etc/systemd/system")
_READABLE = 0o644


def run(arguments: Namespace) -> int:
    """Do what the arguments say. Returns the exit code."""
    return {"install": _install, "show": _show, "uninstall": _uninstall}[arguments.what](arguments)


def _install(arguments: Namespace) -> int:
    try:
        load(arguments.session)
    except SessionError as error:
        print_error(str(error))
        return USAGE
    service = _service(arguments)
    path = _folder(arguments.system) / service.name
    text = service.text()
    try:
        old = path.read_text(encoding="utf-8") if path.exists() else None
        if old is not None and old != text and not arguments.force:
            print_error(f"{path}: exists already, and is another unit; --force replaces it. This one: "
                        f"rsb-console service show {arguments.session}")  # fmt: skip
            return FAILURE
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, text.encode())
        path.chmod(_READABLE)
    except OSError as error:
        hint = ": run it with sudo" if isinstance(error, PermissionError) and arguments.system else ""
        print_error(f"{path}: cannot be written: {why_not_written(error, path)}{hint}")
        return FAILURE
    print_line(f"{path}: {'written' if old is None else 'unchanged' if old == text else 'replaced'}. Run next:")
    control = _systemctl(arguments.system)
    for command, why in (
        (f"{control} daemon-reload", ""),
        (f"{control} enable --now {service.name}", "starts it now, and whenever the machine starts"),
        ("" if arguments.system else "loginctl enable-linger", "so that it runs while you are not logged in, too"),
        (f"{control} reload {service.name}", "later: reads the session file again, and changes what differs"),
    ):
        if command:
            print_line(f"  {command}" + (f"  # {why}" if why else ""))
    return OK


def _show(arguments: Namespace) -> int:
    print_lines(_service(arguments).text().removesuffix("\n"))
    return OK


def _uninstall(arguments: Namespace) -> int:
    name = unit_name(arguments.session)
    folder = _folder(arguments.system)
    path, control = folder / name, _systemctl(arguments.system)
    enabled = [link for link in folder.glob(f"*.wants/{name}") if link.is_symlink()]
    try:
        if not path.exists():
            print_error(f"{path}: there is no such unit")
            return FAILURE
        if enabled:
            print_error(f"{name} is enabled; first run: {control} disable --now {name}")
            return FAILURE
        if not path.read_text(encoding="utf-8").startswith(MARK) and not arguments.force:
            print_error(f"{path}: `service install` has not written this; --force removes it")
            return FAILURE
        path.unlink()
    except OSError as error:
        print_error(f"{path}: cannot be removed: {error.strerror}")
        return FAILURE
    print_lines(f"{path}: removed. Run next:\n  {control} daemon-reload")
    return OK


def _service(arguments: Namespace) -> Service:
    session = Path(os.path.abspath(arguments.session))  # noqa: PTH100 -- symbolic links stay as they were named
    setup = arguments.setup or _own_setup(os.environ)
    return Service(
        session=session,
        program=_program(),
        system=arguments.system,
        user=_owner(session),
        setup=None if setup is None else Path(os.path.abspath(setup)),  # noqa: PTH100
        environment={name: os.environ[name] for name in KEPT_VARIABLES if name in os.environ},
    )


def _program() -> tuple[str, ...]:
    """How this command was run, from anywhere."""
    found = shutil.which(sys.argv[0])
    if found is not None and Path(found).name == "rsb-console":
        return (os.path.abspath(found),)  # noqa: PTH100
    return sys.executable, "-m", "rsb_console"


def _own_setup(environ: Mapping[str, str]) -> Path | None:
    """The setup.bash of the distribution's ROS, if this shell has sourced it."""
    path = Path("/opt/ros") / environ.get("ROS_DISTRO", "") / "setup.bash"
    return path if environ.get("ROS_DISTRO") and path.is_file() else None


def _owner(session: Path) -> str:
    """Whoever may read the session's keys: they have mode 0600."""
    try:
        return pwd.getpwuid(session.stat().st_uid).pw_name
    except (OSError, KeyError):
        return pwd.getpwuid(os.getuid()).pw_name


def _folder(system: bool) -> Path:
    if system:
        return _SYSTEM_UNITS
    configuration = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(configuration) / "systemd" / "user"


def _systemctl(system: bool) -> str:
    return "sudo systemctl" if system else "systemctl --user"
