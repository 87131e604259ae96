"""Engines that announce themselves in a real Zenoh network, and consoles of operators there."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

import msgspec
from tests.console.scripted import SESSION, ScriptedEngine
from tests.support.control import Machine
from tests.support.operators import ANNA, BOB, granted
from tests.support.waiting import eventually

from rsb_bridge.config.keys import copy_key
from rsb_bridge.control.remote_engine import RemoteEngine
from rsb_bridge.engine.access import Access
from rsb_bridge.model.clock import Clock
from rsb_bridge.telemetry.event_log import EventLog
from rsb_extras.operators.fleet_file import FleetFile
from rsb_extras.operators.zenoh_fleet import EngineAnnouncement, FleetConnector
from rsb_extras.operators.zenoh_source import ZenohFleet
from rsb_extras.zenoh import ZenohSettings
from rsb_extras.zenoh.network import Network
from rsb_extras.zenoh.tests.zenoh_router import Router, stranger

if TYPE_CHECKING:
    from pathlib import Path

    import zenoh

    from rsb_bridge.config.keys import Key
    from rsb_bridge.control.control_server import ControlServer


class Fleet:
    """Engines in one network, and consoles of operators.

    Attributes:
        accesses: who may attach, by the engine's name.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.engines: dict[str, ScriptedEngine] = {}
        self.servers: dict[str, ControlServer] = {}
        self.accesses: dict[str, Access] = {}
        self.networks: dict[str, Network] = {}
        self._resources = ExitStack()
        self.router = Router()
        self._resources.callback(self.router.close)

    @property
    def settings(self) -> ZenohSettings:
        return ZenohSettings((self.router.endpoint,), fleet="lab")

    def add(self, name: str, engine: ScriptedEngine | None = None, *, host: str = "robot") -> None:
        """Announce an engine, and wait until the router knows it.

        Args:
            engine: a scripted one if none is given.
            host: of a second one of a name, tells its socket from the first one's.
        """
        with stranger(self.router) as somebody:
            before = announced(somebody)
            self.begin(name, engine, host=host)
            eventually(lambda: announced(somebody) - before)

    def begin(self, name: str, engine: ScriptedEngine | None = None, *, host: str = "robot") -> None:
        """Add an engine without waiting for it."""
        folder = self.folder / host
        folder.mkdir(exist_ok=True)
        engine = engine or ScriptedEngine(msgspec.structs.replace(SESSION, name=name))
        machine = Machine(folder)
        server = machine.serve(engine)
        access = Access(name, EventLog(Clock()), Clock())
        access.grant(granted("anna", ANNA) | granted("bob", BOB, "look"))
        network = Network(self.settings, folder)
        EngineAnnouncement(server, access, network)
        self._resources.callback(machine.close)
        self._resources.callback(network.close)
        self.engines[name], self.servers[name], self.accesses[name] = engine, server, access
        self.networks[name] = network

    def file(self, operator: str = "anna", key: Key = ANNA) -> FleetFile:
        return FleetFile(self.settings, operator, key, self.folder)

    def write_file(self, operator: str, key: Key) -> Path:
        """The file by which an operator's commands reach this fleet."""
        key_file = self.folder / f"{operator}.key"
        copy_key(key, key_file)
        path = self.folder / f"{operator}.yaml"
        zenoh = f"zenoh: {{connect: [{self.router.endpoint}], fleet: {self.settings.fleet}}}\n"
        path.write_text(f"{zenoh}operator: {operator}\nkey_file: {key_file.name}\n")
        return path

    def seen_by(self, operator: str = "anna", key: Key = ANNA) -> ZenohFleet:
        """A console's fleet, started."""
        fleet = ZenohFleet(self.file(operator, key))
        fleet.start()
        self._resources.callback(fleet.stop)
        return fleet

    def attach(self, engine: str, operator: str = "anna", key: Key = ANNA) -> RemoteEngine:
        remote = RemoteEngine(FleetConnector(self.file(operator, key), engine))
        remote.start()
        self._resources.callback(remote.stop)
        return remote

    def close(self) -> None:
        self._resources.close()


def announced(somebody: zenoh.Session) -> set[str]:
    """The engines that the router knows, as their announcements are called."""
    replies = somebody.liveliness().get("rsb_console/lab/here/engine/*/*")
    return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
