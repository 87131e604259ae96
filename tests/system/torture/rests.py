"""The last messages that reach a robot after an arming has ended, for each kind of end.

Somebody drives while the topic is armed: a node or a hand on the control PC, or a hand on the robot's own bridge. Then
the arming ends, and an outside node on the robot's side notes what still comes.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Literal, TypeAlias

import msgspec
from tests.support.waiting import eventually
from tests.system.torture.ends import VELOCITY
from tests.system.torture.judge import CLOCK_TOLERANCE, Witness
from tests.system.torture.stage import TOPIC, TWIST, Stage

from rsb_bridge.api import EngineError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.system.torture.ends import Arrival
    from tests.system.torture.program import Command
    from tests.system.torture.stage import Bridge, Nodes, Side, Transport

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_extras.zenoh.tests.zenoh_router import Router

Driver: TypeAlias = Literal["node", "hand", "hand on robot"]
DRIVERS: tuple[Driver, ...] = ("node", "hand", "hand on robot")

WITHIN = 0.1
"""s from the moment when the robot's side knows of the end until its rest."""
CUT_WITHIN = 1.2
"""s from a cut, which nobody reports to the robot's side, until its rest."""
_SIGNAL_WITHIN = 0.2
"""s until a bridge has noticed a signal, and its side of the link has ended."""
_WATCHED = 3.5
_DEADMAN = 2.0
_KEYS = 10.0  # Hz


@dataclass
class Rested:
    """The messages that the robot's node heard from the end of an arming on.

    Attributes:
        moving_after_rest: messages that move and came after the first rest.
        moving_late: messages that move and came after the allowed time.
        last: what it heard last.
        after: s from the end until the first rest, or None without one.
        within: s in which the rest has to come.
        notes: what else there is to say.
    """

    moving_after_rest: int
    moving_late: int
    last: str
    after: float | None
    within: float
    rests: int
    notes: list[str] = field(default_factory=list)

    @property
    def wrong(self) -> bool:
        """Whether the robot was left moving, or for too long."""
        late = self.moving_late > 0 or self.after is None or self.after > self.within
        return late or self.moving_after_rest > 0 or self.last != "rest"


@dataclass
class _Scene:
    """One case.

    Attributes:
        bridge: of the ending's side.
        holder: the command that armed the topic.
    """

    stage: Stage
    bridge: Bridge
    holder: Command

    @property
    def console(self) -> RemoteEngine:
        return self.bridge.console

    @property
    def key(self) -> str:
        return self.bridge.routes()[0].key

    @property
    def router(self) -> Router:
        assert self.stage.router is not None
        return self.stage.router

    def edit(self) -> None:
        spec = self.bridge.routes()[0].spec
        self.console.edit_topic(self.key, msgspec.structs.replace(spec, compression="zstd")).result(30)


@dataclass(frozen=True)
class Ending:
    """A way in which an arming ends.

    Attributes:
        side: the side on which that happens.
        within: s from then until the robot's rest.
        deadman: the entry's.
        released: whether the network or the process goes on after a while, so that late messages come.
    """

    does: Callable[[_Scene], object]
    side: Side = "pc"
    within: float = WITHIN
    deadman: float = 0.0
    released: bool = False


_BOTH: dict[str, Ending] = {
    "disarm": Ending(lambda scene: scene.console.disarm(scene.key).result(30)),
    "pause": Ending(lambda scene: scene.console.pause(scene.key, True).result(30)),
    "remove": Ending(lambda scene: scene.console.remove_topic(scene.key).result(30)),
    "edit": Ending(_Scene.edit),
    "reload": Ending(lambda scene: scene.console.reload().result(30)),
    "restart": Ending(lambda scene: scene.console.restart().result(30)),
    "SIGTERM": Ending(lambda scene: scene.bridge.command.signal(signal.SIGTERM), within=_SIGNAL_WITHIN),
}
_SILENT_CONSOLE = 5.5
"""s after which a console counts as gone, and until that is noticed."""
_KILLED = "pc: kill -9"
ENDINGS: dict[str, Ending] = {
    **{f"pc: {name}": each for name, each in _BOTH.items()},
    **{f"robot: {name}": Ending(each.does, "robot", each.within) for name, each in _BOTH.items()},
    _KILLED: Ending(lambda scene: scene.bridge.command.signal(signal.SIGKILL)),
    "pc: frozen": Ending(lambda scene: scene.bridge.command.signal(signal.SIGSTOP), within=CUT_WITHIN, released=True),
    "cut": Ending(lambda scene: scene.stage.relay.hold(), within=CUT_WITHIN, released=True),
    "console killed": Ending(lambda scene: scene.holder.signal(signal.SIGKILL)),
    "console frozen": Ending(lambda scene: scene.holder.signal(signal.SIGSTOP), within=_SILENT_CONSOLE + WITHIN),
    # no key comes on the console that holds the topic
    "deadman": Ending(lambda _: None, within=_DEADMAN + WITHIN, deadman=_DEADMAN),
    "router killed": Ending(lambda scene: scene.router.kill(), within=CUT_WITHIN),
    "router stopped": Ending(lambda scene: scene.router.pause(), within=CUT_WITHIN, released=True),
}


def fits(name: str, transport: Transport) -> bool:
    """Whether an ending is possible over a transport."""
    return transport.startswith("zenoh") or not name.startswith("router")


def run(nodes: Nodes, name: str, transport: Transport, driver: Driver) -> Rested:
    """End an arming, and note what the robot's node hears from then on."""
    ending = ENDINGS[name]
    with Stage(nodes, transport, entry=TWIST | {"deadman": ending.deadman}) as stage:
        stage.prepare(twist=True, talks=driver == "node")
        side = stage.robot if driver == "hand on robot" else stage.pc
        armed_at = time.monotonic()
        holder = side.run("arm", TOPIC)
        bridge = stage.side(ending.side)
        with _driven(side) if driver != "node" else contextlib.nullcontext():
            moving = _await_motion(stage, holder)
            armed_at = moving[0].arrived
            began = armed_at if ending.deadman else time.monotonic()
            ending.does(_Scene(stage, bridge, holder))
            within = CUT_WITHIN if name == _KILLED and transport.startswith("zenoh") else ending.within
            time.sleep(within + 0.5)
            if ending.released:
                time.sleep(4.0)  # until the arming has ended for good: later messages are late
                stage.relay.release()
                bridge.command.signal(signal.SIGCONT)
                if stage.router is not None:
                    stage.router.go_on()
            time.sleep(_WATCHED - 1.0)
        return _judge(stage, began, within)


def _await_motion(stage: Stage, holder: Command) -> list[Arrival]:
    def moving() -> list[Arrival] | None:
        found = [each for each in stage.heard() if each.number]
        return found if len(found) >= 3 else None

    try:
        return eventually(moving, what="it moves")
    except AssertionError as error:
        raise AssertionError(f"{error}; running: {holder.running} {holder.output[-300:]}; {stage.describe()}") from None


def _judge(stage: Stage, began: float, within: float) -> Rested:
    every = stage.arrivals()
    tolerance = Witness(every).worst + CLOCK_TOLERANCE
    heard = sorted((each for each in every if each.topic == TOPIC), key=lambda each: each.arrived)
    since = [each for each in heard if each.arrived >= began]
    rests = [each.arrived for each in since if not each.number]
    last = heard[-1]
    first = rests[0] if rests else None
    after_rest = sum(1 for each in since if each.number and first is not None and each.arrived > first)
    too_late = sum(1 for each in since if each.number and each.arrived > began + within + tolerance)
    return Rested(
        after_rest,
        too_late,
        "moving" if last.number else "rest",
        None if first is None else first - began,
        within + tolerance,
        len(rests),
        [f"armed again {stage.describe()}"] if too_late else [],
    )


@contextlib.contextmanager
def _driven(bridge: Bridge) -> Iterator[None]:
    """Hold a key: the bridge gets a velocity ten times a second, as the drive screen sends it."""
    over = threading.Event()
    publish = import_module("rsb_extras.driving.publish_requests").Publish  # of a feature, which the core is without

    def drive() -> None:
        ticket = 0
        while not over.wait(1 / _KEYS):
            try:
                velocity = f"linear: {{x: {VELOCITY}}}"
                published = bridge.console.do(publish(TOPIC, velocity, TWIST["type"], ticket, "{}")).result(5)
                ticket = published.ticket
                if not published.is_done:
                    continue
            except (EngineError, TimeoutError):
                pass

    thread = threading.Thread(target=drive, name="key")
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
