"""A robot and a control PC: both programs, a network between them, ROS nodes at both ends, consoles on both sides."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import yaml
from tests.support.ports import free_port
from tests.support.program import free_shared_memory
from tests.support.relay import Relay
from tests.support.waiting import eventually
from tests.system.torture.clock import SteppedClock
from tests.system.torture.ends import Ear, Talker
from tests.system.torture.judge import Findings, Window, judge
from tests.system.torture.program import Command, Commands

from rsb_bridge.api import EngineError
from rsb_bridge.config.keys import write_key
from rsb_bridge.control.remote_engine import RemoteEngine

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.system.torture.ends import Arrival

    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_extras.zenoh.tests.zenoh_router import Router

Transport: TypeAlias = Literal["tcp", "udp", "zenoh", "zenoh-drop"]
Side: TypeAlias = Literal["robot", "pc"]
SIDES: tuple[Side, ...] = ("robot", "pc")
TOPIC = "/cmd"
TWIST = {"type": "geometry_msgs/msg/Twist"}
"""Settings of its entry, if it carries velocities."""
RATE = 100.0

_SHOW_DISARMED = {"disarmed", "down"}
"""States in which a console shows an unarmed topic as disarmed: not `disarming`."""
_LOOK_EVERY = 0.02
_FLOWS_WITHIN = 120.0
_SIGN_OF_LIFE_EVERY = 0.5


class Bridge:
    """One side's program, and a console that is attached to it.

    Attributes:
        console: attached to it, from `attach` on.
        freezes: from when to when its process was stopped.
    """

    def __init__(self, commands: Commands, file: Path) -> None:
        self._commands = commands
        self._file = file
        self.control = Path(f"{file}.sock")
        self.command: Command
        self.console: RemoteEngine
        self.freezes: list[tuple[float, float]] = []
        self.start()

    def start(self) -> None:
        """Run the session."""
        options = ("--no-ui", "--log-format", "json", "--control", str(self.control))
        self.command = self._commands.start("run", str(self._file), *options)

    def kill(self) -> None:
        """kill -9."""
        self.command.kill()

    def attach(self) -> None:
        """Attach a console, which comes back by itself when the program is started again."""

        def attached() -> RemoteEngine | None:
            console = RemoteEngine(self.control)
            try:
                console.start()
            except EngineError:
                return None
            return console

        self.console = eventually(attached, what=f"a console; the program says {self.command.output[-2000:]}")

    def run(self, command: str, *arguments: str) -> Command:
        """Begin ``rsb-console COMMAND`` for this bridge."""
        return self._commands.start(command, "--control", str(self.control), *arguments)

    def routes(self, topic: str = TOPIC) -> list[RouteSnapshot]:
        """All routes of a topic, as its console shows them."""
        return [each for each in self.console.snapshot().routes if each.topic == topic]

    @property
    def linked(self) -> bool:
        """Whether it answers and its link is up."""
        links = self.console.snapshot().links
        return not self.console.unreachable and bool(links) and all(each.state == "ok" for each in links)

    def shows(self) -> tuple[bool, str] | None:
        """Whether its console shows the topic disarmed, and in which words; None if it shows neither that nor armed."""
        if self.console.unreachable:
            return None
        found = [each for each in self.routes() if each.arming is not None]
        if any(each.arming is not None and each.arming.armed for each in found):
            return False, ""
        if not found or any(each.state not in _SHOW_DISARMED for each in found):
            return None
        return True, "; ".join(f"{each.state}: {each.reason}" for each in found)

    @contextlib.contextmanager
    def frozen(self) -> Iterator[None]:
        """Stop the whole process for the length of the block."""
        self.command.signal(signal.SIGSTOP)
        began = time.monotonic()
        try:
            yield
        finally:
            self.freezes.append((began, time.monotonic()))
            self.command.signal(signal.SIGCONT)


@dataclass
class Nodes:
    """The ROS nodes of all cases, which outlive the bridges.

    Attributes:
        domains: the robot's, and the control PC's.
        talker: publishes commands on the control PC's side.
        ear: listens on the robot's side.
        commands: start the programs of each side.
        clocks: of each side, or empty if both have the true one.
        stages: how many bridges these nodes have seen.
    """

    domains: tuple[int, int]
    talker: Talker
    ear: Ear
    commands: dict[Side, Commands]
    folder: Path
    clocks: dict[Side, SteppedClock]
    stages: int = 0

    @classmethod
    def start(cls, folder: Path, first: int, *, stepped: bool = False) -> Nodes:
        """Start them in two domains.

        Args:
            first: the robot's domain; the control PC's is the next one.
            stepped: the two sides have clocks that can be stepped.
        """
        clocks: dict[Side, SteppedClock] = {}
        if stepped:
            clocks = {"robot": SteppedClock(folder, "robot"), "pc": SteppedClock(folder, "pc")}
        commands: dict[Side, Commands] = {}
        for side in SIDES:
            (folder / side).mkdir()
            commands[side] = Commands(folder / side, clocks[side].environ if stepped else None)
        talker = Talker(first + 1, first, clocks["pc"].environ if stepped else None)
        ear = Ear(first, folder / "arrivals")
        return cls((first, first + 1), talker, ear, commands, folder, clocks)

    def close(self) -> None:
        """End them."""
        for each in self.commands.values():
            each.close()
        self.talker.close()
        self.ear.close()
        free_shared_memory()


class Stage:
    """A bridge over one transport. A context manager.

    Args:
        entry: further settings of `TOPIC`, which requires arming.

    Attributes:
        pc: the control PC's.
        relay: the network between them; over Zenoh, between the robot and the router.
        windows: times in which an operator meant messages to cross.
        notes: what an attack has to say.
    """

    def __init__(self, nodes: Nodes, transport: Transport = "tcp", *, entry: dict[str, Any] | None = None) -> None:
        self._nodes = nodes
        self.transport = transport
        self.router: Router | None = None
        self.relay: Relay
        self.windows: list[Window] = []
        self.notes: list[str] = []
        self._resources = contextlib.ExitStack()
        self._lock = threading.Lock()
        self._entry = entry or {}
        self._arms: Bridge | None = None
        self._over = threading.Event()

    def __enter__(self) -> Stage:
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            self._start()
            undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the programs and the network."""
        self._over.set()
        self._resources.close()

    def _start(self) -> None:
        nodes = self._nodes
        nodes.stages += 1
        folder = nodes.folder / f"stage{nodes.stages}"
        folder.mkdir()
        write_key(folder / "key.txt")
        common: dict[str, Any] = {"name": "robot1", "key_file": "key.txt"}
        places: dict[Side, dict[str, Any]]
        if self.transport.startswith("zenoh"):
            from rsb_extras.zenoh.tests.zenoh_router import Router

            self.router = Router()
            self._resources.callback(self.router.close)
            self.relay = self._resources.enter_context(Relay(("127.0.0.1", self.router.port)))
            zenoh: dict[Side, str] = {"robot": f"tcp/127.0.0.1:{self.relay.port}", "pc": self.router.endpoint}
            places = {
                side: {"server_ip": "zenoh", "zenoh": {"connect": [endpoint]}} for side, endpoint in zenoh.items()
            }
        else:
            port = free_port()
            self.relay = self._resources.enter_context(Relay(("127.0.0.1", port)))
            places = {
                side: {"server_ip": "127.0.0.1", "server_port": port if side == "pc" else self.relay.port}
                for side in SIDES
            }
        topic = {"topic": TOPIC, "direction": "receive", "arm": True, "deadman": 0, "protocol": self.transport}
        roles: dict[Side, dict[str, Any]] = {
            "robot": {"role": "client", "topics": [topic | self._entry]},
            "pc": {"role": "server"},
        }
        bridges = {}
        for side, domain in zip(SIDES, nodes.domains, strict=True):
            session = common | places[side] | {"domain_id": domain} | roles[side]
            file = folder / f"{side}.yaml"
            file.write_text(yaml.safe_dump(session, sort_keys=False))
            bridges[side] = Bridge(nodes.commands[side], file)
            self._resources.callback(bridges[side].kill)
        self.robot, self.pc = bridges["robot"], bridges["pc"]
        for bridge in (self.robot, self.pc):
            bridge.attach()
            self._resources.callback(bridge.console.stop)
        watching = threading.Thread(target=self._watch, name="watch")
        watching.start()
        self._resources.callback(watching.join)
        self._resources.callback(self._over.set)

    def side(self, side: Side) -> Bridge:
        return self.robot if side == "robot" else self.pc

    # --- what people do

    def prepare(self, *, twist: bool = False, talks: bool = True) -> None:
        """Publish from now on, as velocities with `twist`, and wait until the topic is set up and can be armed."""
        self._nodes.ear.listen([TOPIC], twist=twist)
        self._nodes.talker.talk([TOPIC] if talks else [], RATE, twist=twist)
        self.await_disarmed()

    def await_disarmed(self, within: float = 180.0) -> None:
        """Wait until both sides are linked and show the topic disarmed, ready to be armed."""

        def ready() -> bool:
            found = [route for bridge in (self.robot, self.pc) for route in bridge.routes()]
            linked = self.robot.linked and self.pc.linked and len(found) > 1
            return linked and all(
                each.state == "disarmed" and (each.arming is None or not each.arming.armed)
                for each in found  # a state may be the other side's
            )

        eventually(ready, within, f"disarmed on both sides: {self.describe()}")

    def describe(self, topic: str = TOPIC) -> str:
        """Return both sides' states of a topic."""
        lines = []
        for name, bridge in (("robot", self.robot), ("pc", self.pc)):
            shown = [f"{each.state} {each.cause}: {each.reason}" for each in bridge.routes(topic)]
            lines.append(f"{name}: {bridge.console.unreachable or shown}")
        return "; ".join(lines)

    def arm(self, bridge: Bridge | None = None) -> Window:
        """Arm the topic, on the control PC's console if no other is named, and keep it armed as far as that goes."""
        bridge = bridge or self.pc
        window = Window(time.monotonic())
        with self._lock:
            self.windows.append(window)
            self._arms = bridge
        try:
            bridge.console.arm(bridge.routes()[0].key).result(60)
        except EngineError:
            with self._lock:
                window.show("an error")
            raise
        window.agreed = True
        return window

    def arm_and_flow(self, count: int = 20, by: Bridge | None = None) -> Window:
        """Arm the topic, and wait until messages cross.

        A side that stands still for a second refuses to be armed, or is disarmed. That has a window of its own.
        """
        deadline = time.monotonic() + _FLOWS_WITHIN
        while True:
            try:
                window = self.arm(by)
            except EngineError:
                if time.monotonic() > deadline:
                    raise
            else:
                if self._flows(window, count, deadline):
                    return window
            self.await_disarmed()

    def begin_window(self) -> Window:
        """Note that an operator is about to arm the topic by other means."""
        window = Window(time.monotonic(), agreed=True)
        with self._lock:
            self.windows.append(window)
            self._arms = None
        return window

    def await_flow(self, window: Window, count: int = 20) -> None:
        """Wait until messages cross that were published since then."""
        assert self._flows(window, count, time.monotonic() + _FLOWS_WITHIN), "it was disarmed before"

    def _flows(self, window: Window, count: int, deadline: float) -> bool:
        """Wait until messages cross that were published since then; whether they did before it was disarmed."""
        while sum(each.published > window.asked for each in self.heard()) <= count:
            if window.shown is not None:
                return False
            assert time.monotonic() < deadline, f"no messages cross: {self.describe()}"
            time.sleep(0.05)
        return True

    def disarm(self, bridge: Bridge | None = None) -> Command:
        """Begin the operator's command on the control PC."""
        return (bridge or self.pc).run("disarm", TOPIC)

    def disarmed(self) -> None:
        """Whether an operator got the answer that the topic is disarmed."""
        with self._lock:
            self.windows[-1].show("the command")

    def settle(self) -> None:
        """Stop publishing, and wait until nothing more comes."""
        self._nodes.talker.talk([], RATE)
        last, since = -1, time.monotonic()
        while time.monotonic() - since < 1.0:
            count = len(self.heard())
            if count != last:
                last, since = count, time.monotonic()
            time.sleep(0.05)

    def findings(self) -> Findings:
        """Judge all that has reached the robot."""
        arrivals, true_clock = self._nodes.ear.arrivals(), not self._nodes.clocks
        return judge(arrivals, self.windows, frozen=self.robot.freezes, true_clock=true_clock)

    def heard(self) -> list[Arrival]:
        """All messages of the topic that have reached the robot's node."""
        return [each for each in self._nodes.ear.arrivals() if each.topic == TOPIC]

    def arrivals(self) -> list[Arrival]:
        """All messages that have reached the robot's node, the witness's included."""
        return self._nodes.ear.arrivals()

    # --- the watching thread

    def _watch(self) -> None:
        """Note when either side first shows that the topic is disarmed after it has shown it armed."""
        showed: dict[str, Window] = {}
        kept_at = 0.0
        while not self._over.wait(_LOOK_EVERY):
            now = time.monotonic()
            if now - kept_at > _SIGN_OF_LIFE_EVERY and self._arms is not None:
                kept_at = now
                self._arms.console.keep_armed(pressed=False)
            for name, bridge in (("the robot's console", self.robot), ("the pc's console", self.pc)):
                with self._lock:
                    window = self.windows[-1] if self.windows else None
                shows = bridge.shows()
                if window is None or shows is None:
                    continue
                disarmed, words = shows
                if not disarmed:
                    if window.agreed:
                        showed[name] = window
                elif showed.get(name) is window:
                    with self._lock:
                        window.show(f"{name} ({words})")
