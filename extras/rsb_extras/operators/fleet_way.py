"""The way to the engines of a fleet over Zenoh, by a fleet file. What it needs is imported when it is gone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.feature_console import RemoteWay

if TYPE_CHECKING:
    from rsb_bridge.feature_api import RemoteEngine
    from rsb_extras.operators.fleet_file import FleetFile
    from rsb_extras.operators.zenoh_source import ZenohFleet


class FleetWay(RemoteWay):
    option = "--fleet"
    one = "a fleet file: the bridge is one of that fleet, reached over Zenoh"
    many = "a fleet file: all bridges of that fleet, over Zenoh, instead of the servers here"

    def check(self) -> None:
        self._read()

    def attach(self, bridge: str, *, read_only: bool) -> RemoteEngine:
        from rsb_bridge.feature_api import attach  # noqa: PLC0415 -- the module says why, here and below
        from rsb_console.feature_console import print_error  # noqa: PLC0415
        from rsb_extras.operators.zenoh_fleet import FleetConnector  # noqa: PLC0415

        connector = FleetConnector(self._read(), bridge)
        engine = attach(connector, read_only=read_only)
        if connector.warning:
            print_error(connector.warning)
        return engine

    def robots(self) -> ZenohFleet:
        from rsb_extras.operators.zenoh_source import ZenohFleet  # noqa: PLC0415

        return ZenohFleet(self._read())

    def _read(self) -> FleetFile:
        from rsb_bridge.config.keys import KeyFileError  # noqa: PLC0415
        from rsb_bridge.config.yaml_text import SessionError  # noqa: PLC0415
        from rsb_console.feature_console import UsageError  # noqa: PLC0415
        from rsb_extras.operators.fleet_file import load_fleet  # noqa: PLC0415

        try:
            return load_fleet(self.file)
        except (SessionError, KeyFileError) as error:
            raise UsageError(str(error)) from None
