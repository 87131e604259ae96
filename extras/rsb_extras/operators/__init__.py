"""Operators over networks: engines announce themselves in a Zenoh network, where operators attach with their keys.

`zenoh_fleet.EngineAnnouncement` announces the engine, and `zenoh_fleet.FleetPresence.join` finds it. The stream of a
`rsb_bridge.control.sealed.OperatorConnector` is a `rsb_extras.zenoh.pipe.Pipe`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.feature_api import Feature
from rsb_extras.zenoh import ZENOH

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.feature_api import ControlServer
    from rsb_console.feature_console import RemoteWay


class Operators(Feature):
    name = "operators"
    needs: ClassVar[tuple[str, ...]] = ("zenoh",)

    def serve(self, server: ControlServer) -> None:
        if ZENOH.of(server.engine.session) is not None:
            from rsb_extras.operators.zenoh_fleet import announce  # noqa: PLC0415 -- `Feature` says why, here and below

            announce(server)

    def ways(self) -> Iterable[type[RemoteWay]]:
        from rsb_extras.operators.fleet_way import FleetWay  # noqa: PLC0415

        return (FleetWay,)


FEATURE = Operators()
