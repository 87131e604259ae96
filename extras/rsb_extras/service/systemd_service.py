"""`rsb-console service`: writes, shows and removes the systemd unit of a session, and prints the next commands."""

from __future__ import annotations

import os
import pwd
import re
import shutil
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.files import remove_file
from rsb_bridge.feature_api import SessionError, Wording, load, make_folder, replace_file, why_not_written
from rsb_console.feature_console import FAILURE, OK, USAGE, print_error, print_line, print_lines

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Mapping, Sequence

MARK = "# Written by `rsb-console service install`. `rsb-console service uninstall` removes it."
_KEPT = re.compile(r"(ROS|ROS2|RMW|RCL|FASTDDS|FASTRTPS)_\w+|CYCLONEDDS_URI|ZENOH_\w*CONFIG\w*")
"""Variables that ROS and its middlewares read from the environment; a service does not have the shell's."""
_LEFT_OUT = frozenset({"ROS_DISTRO", "ROS_VERSION", "ROS_PYTHON_VERSION", "ROS_PACKAGE_PATH", "ROS_LOG_DIR"})
"""Variables that each setup file sets, and the folder of logs, which the unit names itself."""
CONFINED = (
    "CapabilityBoundingSet=",
    "ProtectSystem=strict",
    "PrivateTmp=true",
    "PrivateDevices=true",
    "ProtectClock=true",
    "ProtectControlGroups=true",
    "ProtectHostname=true",
    "ProtectKernelLogs=true",
    "ProtectKernelModules=true",
    "ProtectKernelTunables=true",
    "ProtectProc=invisible",
    "LockPersonality=true",
    "RestrictNamespaces=true",
    "RestrictRealtime=true",
    "RestrictSUIDSGID=true",
    "RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK AF_BLUETOOTH",
    "SystemCallArchitectures=native",
    "SystemCallFilter=@system-service",
    "SystemCallFilter=landlock_create_ruleset landlock_add_rule landlock_restrict_self",
    "SystemCallFilter=~@privileged @resources",
    "SystemCallErrorNumber=EPERM",
)
"""What a service of the system may do, and no more. configs/rsb-console@.service has the same, and says why."""
# After `exec`, the bridge is the main process, whose reports (Type=notify) and reloads ($MAINPID) count.
_SOURCING = 'source "$0" && exec "$@"'
_HOMES = ("/home/", "/root/", "/run/user/")
_SYSTEM_UNITS = Path("/etc/systemd/system")
_READABLE = 0o644


class ServiceText(Wording):
    """Reports of `rsb-console service`."""

    OTHER_UNIT = (
        "{path}: another unit exists; --force replaces it. To print this one: rsb-console service show {session}"
    )
    NO_UNIT = "{path}: there is no such unit"
    ENABLED = "{name} is enabled; first run: {control} disable --now {name}"


@dataclass(frozen=True, slots=True)
class Service:
    """One session as a service.

    Attributes:
        session: absolute path of the session file.
        program: command that runs rsb-console: its absolute path, or an interpreter and a module.
        system: whether it is a system service rather than the user's.
        user: user that runs a system service.
        setup: absolute path of ROS's or a workspace's setup.bash, or None if `program` finds ROS by itself.
    """

    session: Path
    program: Sequence[str]
    system: bool
    user: str
    setup: Path | None = None
    environment: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return unit_name(self.session)

    def text(self) -> str:
        network = ["Wants=network-online.target", "After=network-online.target bluetooth.service"]
        lines = [
            MARK,
            "[Unit]",
            f"Description=ROS 2 topic bridge, session {self.session.stem.replace('%', '%%')}",
            *(network if self.system else []),
            "",
            "[Service]",
            "Type=notify",
            "# The bridge reports that it works; systemd restarts one that hangs.",
            "WatchdogSec=30",
            *(f"Environment={_quoted(f'{name}={value}')}" for name, value in self.environment.items()),
            f"ExecStart={' '.join(_quoted(word, command=True) for word in self.command())}",
            "# Reads the session file again, and changes only what differs.",
            "ExecReload=/bin/kill -HUP $MAINPID",
            "Restart=on-failure",
            "RestartSec=2",
            "# A restart helps neither a session file with mistakes nor a session that runs already.",
            "RestartPreventExitStatus=2 4",
            "TimeoutStopSec=10",
            "LimitNOFILE=65536",
            "UMask=0077",
            "NoNewPrivileges=true",
            *(self._confined() if self.system else []),
            "",
            "[Install]",
            f"WantedBy={'multi-user' if self.system else 'default'}.target",
            "",
        ]
        return "\n".join(lines)

    def _confined(self) -> list[str]:
        home = "read-only" if str(self.session).startswith(_HOMES) else "true"  # else the session could not be read
        return [
            f"User={self.user}",
            "# Of all such services together: control sockets, the events and their history, and ROS's logs.",
            "RuntimeDirectory=rsb-console",
            "RuntimeDirectoryMode=0700",
            "RuntimeDirectoryPreserve=yes",
            "StateDirectory=rsb-console",
            "LogsDirectory=rsb-console",
            "Environment=ROS_LOG_DIR=%L/rsb-console",
            f"ProtectHome={home}",
            *CONFINED,
        ]

    def command(self) -> list[str]:
        run = [*self.program, "run", "--no-ui", "--log-format", "json", str(self.session)]
        return run if self.setup is None else ["/bin/bash", "-c", _SOURCING, str(self.setup), *run]


def unit_name(session: Path) -> str:
    """Return the name of a session's unit, after its file."""
    stem = re.sub(r"[^A-Za-z0-9:_.-]", "_", session.stem)
    return f"rsb-console-{stem}.service"


def _quoted(word: str, *, command: bool = False) -> str:
    """Quote a word for systemd (systemd.syntax(7)); in a command, also escape `$`, which would expand variables."""
    text = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%")
    text = text.replace("$", "$$") if command else text
    return f'"{text}"'


def install_unit(arguments: Namespace) -> int:
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
            print_error(ServiceText.OTHER_UNIT(path=path, session=arguments.session))
            return FAILURE
        make_folder(path.parent)
        replace_file(path, text.encode(), mode=_READABLE)  # systemd warns of a unit that only its owner can read
    except OSError as error:
        hint = ": run it with sudo" if isinstance(error, PermissionError) and arguments.system else ""
        print_error(f"{path}: cannot be written: {why_not_written(error, path)}{hint}")
        return FAILURE
    print_line(f"{path}: {'written' if old is None else 'unchanged' if old == text else 'replaced'}. Run next:")
    control = _systemctl(arguments.system)
    print_line(f"  {control} daemon-reload")
    print_line(f"  {control} enable --now {service.name}  # starts it now, and whenever the machine starts")
    if not arguments.system:
        print_line("  loginctl enable-linger  # so that it runs while you are not logged in, too")
    print_line(f"  {control} reload {service.name}  # later: reads the session file again, and changes what differs")
    return OK


def show_unit(arguments: Namespace) -> int:
    print_lines(_service(arguments).text().removesuffix("\n"))
    return OK


def uninstall_unit(arguments: Namespace) -> int:
    name = unit_name(arguments.session)
    folder = _folder(arguments.system)
    path, control = folder / name, _systemctl(arguments.system)
    enabled = [link for link in folder.glob(f"*.wants/{name}") if link.is_symlink()]
    try:
        if not path.exists():
            print_error(ServiceText.NO_UNIT(path=path))
            return FAILURE
        # Without its unit, the link in *.wants would lead nowhere.
        if enabled:
            print_error(ServiceText.ENABLED(name=name, control=control))
            return FAILURE
        if not path.read_text(encoding="utf-8").startswith(MARK) and not arguments.force:
            print_error(f"{path}: not written by `service install`; --force removes it")
            return FAILURE
        remove_file(path)
    except OSError as error:
        print_error(f"{path}: cannot be removed: {error.strerror}")
        return FAILURE
    print_lines(f"{path}: removed. Run next:\n  {control} daemon-reload")
    return OK


def _service(arguments: Namespace) -> Service:
    session = Path(os.path.abspath(arguments.session))  # noqa: PTH100 -- symbolic links stay as they were named
    setup: Path | None = arguments.setup
    if setup is None and (distribution := os.environ.get("ROS_DISTRO")):  # this shell has sourced it
        of_ros = Path("/opt/ros") / distribution / "setup.bash"
        setup = of_ros if of_ros.is_file() else None
    return Service(
        session=session,
        program=program(),
        system=arguments.system,
        user=_owner(session),
        setup=None if setup is None else Path(os.path.abspath(setup)),  # noqa: PTH100
        environment=kept_variables(os.environ),
    )


def kept_variables(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of a shell by which the bridge finds the nodes that the shell's programs find."""
    return {name: environ[name] for name in sorted(environ) if _KEPT.fullmatch(name) and name not in _LEFT_OUT}


def program() -> tuple[str, ...]:
    """Return the command line that runs this program from any folder."""
    found = shutil.which(sys.argv[0])
    if found is not None and Path(found).name == "rsb-console":
        return (os.path.abspath(found),)  # noqa: PTH100
    # With -P, a module of the same name in the working folder does not run.
    return sys.executable, "-P", "-m", "rsb_console"


def _owner(session: Path) -> str:
    """Return the user who may read the session's keys, which have mode 0600."""
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
