"""The systemd unit that runs one session: as a service of the user, or of the system."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

MARK = "# Written by `rsb-console service install`; it replaces only what it has written itself."
KEPT_VARIABLES = (
    "ROS_DOMAIN_ID",
    "RMW_IMPLEMENTATION",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "CYCLONEDDS_URI",
)
"""What ROS takes from the environment; a service has none of the shell's."""
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
    "SystemCallFilter=~@privileged @resources",
    "SystemCallErrorNumber=EPERM",
)
"""What a service of the system may do, and no more. configs/rsb-console@.service has the same, and says why."""
_SOURCING = 'source "$0" && exec "$@"'
_HOMES = ("/home/", "/root/", "/run/user/")


@dataclass(frozen=True, slots=True)
class Service:
    """One session as a service.

    Attributes:
        session: the session file, absolute.
        program: how rsb-console is run: its absolute path, or an interpreter and a module.
        system: a service of the system; else of the user.
        user: that a system service runs as.
        setup: the absolute path of ROS's or a workspace's setup.bash; None: `program` finds ROS by itself.
        environment: further variables.
    """

    session: Path
    program: Sequence[str]
    system: bool
    user: str
    setup: Path | None = None
    environment: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of the unit."""
        return unit_name(self.session)

    def text(self) -> str:
        """The unit file."""
        return "\n".join((MARK, *self._unit(), "", *self._service(), "", *self._install(), ""))

    def _unit(self) -> list[str]:
        lines = ["[Unit]", f"Description=ROS 2 topic bridge, session {_plain(self.session.stem)}"]
        if self.system:
            lines += ["Wants=network-online.target", "After=network-online.target bluetooth.service"]
        return lines

    def _service(self) -> list[str]:
        lines = [
            "[Service]",
            "Type=notify",
            "# The bridge says that it works as long as it does; a hung one is started again.",
            "WatchdogSec=30",
            *(f"Environment={_quoted(f'{name}={value}')}" for name, value in self.environment.items()),
            f"ExecStart={' '.join(_quoted(word, command=True) for word in self._command())}",
            "# Reads the session file again, and changes only what differs.",
            "ExecReload=/bin/kill -HUP $MAINPID",
            "Restart=on-failure",
            "RestartSec=2",
            "# Neither a session file with mistakes nor a session that runs already gets better by itself.",
            "RestartPreventExitStatus=2 4",
            "TimeoutStopSec=10",
            "LimitNOFILE=65536",
            "UMask=0077",
            "NoNewPrivileges=true",
        ]
        return lines + self._confined() if self.system else lines

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

    def _command(self) -> list[str]:
        run = [*self.program, "run", "--no-ui", "--log-format", "json", str(self.session)]
        return run if self.setup is None else ["/bin/bash", "-c", _SOURCING, str(self.setup), *run]

    def _install(self) -> list[str]:
        return ["[Install]", f"WantedBy={'multi-user' if self.system else 'default'}.target"]


def unit_name(session: Path) -> str:
    """The name of a session's unit, after its file."""
    stem = re.sub(r"[^A-Za-z0-9:_.-]", "_", session.stem)
    return f"rsb-console-{stem}.service"


def _quoted(word: str, *, command: bool = False) -> str:
    """A word as systemd reads it back (systemd.syntax(7)); in a command, `$` stands for variables, too."""
    text = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%")
    text = text.replace("$", "$$") if command else text
    return f'"{text}"'


def _plain(text: str) -> str:
    return text.replace("%", "%%")
