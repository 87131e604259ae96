"""Service: runs a session as a service of systemd."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from rsb_console.feature_console import AddCommand, Complete


class SystemdService(Feature):
    name = "service"

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_console.feature_console import subcommand  # noqa: PLC0415 -- `Feature` says why

        show = subcommand("rsb_extras.service.systemd_service:show_unit")
        parser = add("service", show, "run a session as a service of systemd", after="demo")
        actions = parser.add_subparsers(metavar="ACTION", required=True)
        for name, summary in (
            ("install", "write the session's unit and print the next commands"),
            ("show", "print the session's unit"),
            ("uninstall", "remove the session's unit"),
        ):
            action = actions.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
            action.set_defaults(command=subcommand(f"rsb_extras.service.systemd_service:{name}_unit"))
            complete(action.add_argument("session", type=Path, metavar="SESSION", help="session file"), "yaml_files")
            action.add_argument("--system", action="store_true", help="a system service, not one of this user")
            if name != "show":
                action.add_argument("--force", action="store_true", help="overwrite or remove a foreign unit, too")
            if name != "uninstall":
                action.add_argument(
                    "--setup", type=Path, metavar="PATH", help="setup.bash of a workspace, sourced first"
                )


FEATURE = SystemdService()
