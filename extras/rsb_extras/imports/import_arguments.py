"""The arguments of the command `import`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rsb_console.feature_console import subcommand

if TYPE_CHECKING:
    from rsb_console.feature_console import AddCommand, Complete


def add_import_command(command: AddCommand, complete: Complete) -> None:
    summary = "convert another bridge's file to a session"
    parser = command("import", subcommand("rsb_extras.imports.import_command:import_sessions"), summary, after="keygen")
    parser.description = (
        "FILE is config/bringup.yaml of ros2_socket_bridge, a configuration of domain_bridge (of which each pair of "
        "domains becomes two sessions), or one of zenoh-bridge-ros2dds. What cannot be carried over is printed, and "
        "written into the session as comments."
    )
    complete(parser.add_argument("file", type=Path, metavar="FILE", help="file to convert"), "yaml_files")
    parser.add_argument("--name", help="name of the bridge; default: the file's, if it has one")
    parser.add_argument("--role", choices=("client", "server"), help="default: as the file has it")
    parser.add_argument("--key-file", type=Path, metavar="PATH", help="file with the key")
    parser.add_argument("--port", type=int, help="port of the server; default: the file's, or 7060")
    parser.add_argument("--domain-id", type=int, metavar="N", help="ROS domain; default: the file's, or $ROS_DOMAIN_ID")
    parser.add_argument("--use-name", action="store_true", help="prefix the client's topics on the server")
    parser.add_argument("--no-encryption", action="store_true", help="all data crosses unencrypted")
    complete(
        parser.add_argument(
            "-o", "--output", type=Path, metavar="PATH", help="file, or folder for several; default: standard output"
        ),
        "yaml_files",
    )
    parser.add_argument("--force", action="store_true", help="replace existing session files")
