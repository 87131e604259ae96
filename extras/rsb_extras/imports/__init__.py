"""Imports: sessions of files of domain_bridge, of zenoh-bridge-ros2dds and of the thesis's ros2_socket_bridge."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from rsb_console.feature_console import Action, AddCommand, Complete


class Imports(Feature):
    name = "imports"
    libraries: ClassVar[Mapping[str, str]] = {"zenoh": "zenoh"}

    def other_file(self, data: Any, path: Path) -> Iterable[str]:
        from rsb_extras.imports.other_bridges import OtherFile, origin_of  # noqa: PLC0415 -- `Feature` says why

        origin = origin_of(data)
        return (OtherFile.CONVERT(origin=origin.value, path=path),) if origin else ()

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_extras.imports.import_arguments import add_import_command  # noqa: PLC0415

        add_import_command(add, complete)

    def actions(self) -> Iterable[Action]:
        from rsb_console.feature_console import (  # noqa: PLC0415
            Action,
            Beginning,
            Group,
            late,
        )

        import_session = Action(
            "import_session", "f3", "import", "Import a file of another bridge", Group.SESSION,
            changes=True, after="new_session", run=late("rsb_extras.imports.import_screen:import_session"),
            begins=Beginning("i", "Import", "a file of ros2_socket_bridge or zenoh-bridge-ros2dds", 4, "Import…"),
        )  # fmt: skip
        return (import_session,)


FEATURE = Imports()
