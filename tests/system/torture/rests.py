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
from typing import TYPE_CHECKING, Literal, TypeAlias

from tests.support.waiting import eventually
from tests.system.torture.ends import VELOCITY
from tests.system.torture.judge import CLOCK_TOLERANCE, Witness
from tests.system.torture.stage import TOPIC, Stage

from rsb_bridge.api import EngineError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.system.torture.ends import Arrival
    from tests.system.torture.forker import Command
    from tests.system.torture.stage import Bridge, Nodes, Transport

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
_ENTRY = {"type": "geometry_msgs/msg/Twist"}


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
        holder: the command that armed the topic.
    """

    stage: Stage
    holder: Command


def _key(bridge: Bridge) -> str:
    return bridge.routes()[0].key


def _disarm(scene: _Scene, bridge: Bridge) -> None:
    bridge.console.disarm(_key(bridge)).result(30)


def _pause(scene: _Scene, bridge: Bridge) -> None:
    bridge.console.pause(_key(bridge), True).result(30)


def _remove(scene: _Scene, bridge: Bridge) -> None:
    bridge.console.remove_topic(_key(bridge)).result(30)


def _edit(scene: _Scene, bridge: Bridge) -> None:
    import msgspec

    route = bridge.routes()[0]
    bridge.console.edit_topic(route.key, msgspec.structs.replace(route.spec, compression="zstd")).result(30)


def _reload(scene: _Scene, bridge: Bridge) -> None:
    bridge.console.reload().result(30)


def _restart(scene: _Scene, bridge: Bridge) -> None:
    bridge.console.restart().result(30)


def _term(scene: _Scene, bridge: Bridge) -> None:
    bridge.command.signal(signal.SIGTERM)


def _kill(scene: _Scene, bridge: Bridge) -> None:
    bridge.command.signal(signal.SIGKILL)


def _freeze(scene: _Scene, bridge: Bridge) -> None:
    bridge.command.signal(signal.SIGSTOP)


def _cut(scene: _Scene, _: Bridge) -> None:
    scene.stage.relay.hold()


def _console_killed(scene: _Scene, _: Bridge) -> None:
    scene.holder.signal(signal.SIGKILL)


def _console_frozen(scene: _Scene, _: Bridge) -> None:
    scene.holder.signal(signal.SIGSTOP)


def _deadman(scene: _Scene, _: Bridge) -> None:
    """No key comes on the console that holds the topic."""


def _router_killed(scene: _Scene, _: Bridge) -> None:
    assert scene.stage.router is not None
    scene.stage.router.kill()


def _router_stopped(scene: _Scene, _: Bridge) -> None:
    assert scene.stage.router is not None
    scene.stage.router.pause()


@dataclass(frozen=True)
class Ending:
    """A way in which an arming ends.

    Attributes:
        side: the side on which that happens.
        within: s from then until the robot's rest.
        deadman: the entry's.
        released: whether the network or the process goes on after a while, so that late messages come.
    """

    does: Callable[[_Scene, Bridge], None]
    side: Literal["pc", "robot"] = "pc"
    within: float = WITHIN
    deadman: float = 0.0
    released: bool = False


_BOTH: dict[str, Ending] = {
    "disarm": Ending(_disarm),
    "pause": Ending(_pause),
    "remove": Ending(_remove),
    "edit": Ending(_edit),
    "reload": Ending(_reload),
    "restart": Ending(_restart),
    "SIGTERM": Ending(_term, within=_SIGNAL_WITHIN),
}
_SILENT_CONSOLE = 5.5
"""s after which a console counts as gone, and until that is noticed."""
ENDINGS: dict[str, Ending] = {
    **{f"pc: {name}": each for name, each in _BOTH.items()},
    **{f"robot: {name}": Ending(each.does, "robot", each.within) for name, each in _BOTH.items()},
    "pc: kill -9": Ending(_kill),
    "pc: frozen": Ending(_freeze, within=CUT_WITHIN, released=True),
    "cut": Ending(_cut, within=CUT_WITHIN, released=True),
    "console killed": Ending(_console_killed),
    "console frozen": Ending(_console_frozen, within=_SILENT_CONSOLE + WITHIN),
    "deadman": Ending(_deadman, within=_DEADMAN + WITHIN, deadman=_DEADMAN),
    "router killed": Ending(_router_killed, within=CUT_WITHIN),
    "router stopped": Ending(_router_stopped, within=CUT_WITHIN, released=True),
}


def fits(name: str, transport: Transport) -> bool:
    """Whether an ending is possible over a transport."""
    return transport.startswith("zenoh") or not name.startswith("router")


def run(nodes: Nodes, name: str, transport: Transport, driver: Driver) -> Rested:
    """End an arming, and note what the robot's node hears from then on."""
    ending = ENDINGS[name]
    with Stage(nodes, transport, entry=_ENTRY | {"deadman": ending.deadman}) as stage:
        stage.prepare(twist=True, talks=driver == "node")
        side = stage.robot if driver == "hand on robot" else stage.pc
        armed_at = time.monotonic()
        holder = side.run("arm", TOPIC)
        scene = _Scene(stage, holder)
        with _driven(side) if driver != "node" else contextlib.nullcontext():
            moving = _await_motion(stage, holder)
            armed_at = moving[0].arrived
            bridge = stage.pc if ending.side == "pc" else stage.robot
            began = armed_at if ending.deadman else time.monotonic()
            ending.does(scene, bridge)
            within = CUT_WITHIN if ending.does is _kill and transport.startswith("zenoh") else ending.within
            time.sleep(within + 0.5)
            if ending.released:
                time.sleep(4.0)  # until the arming has ended for good: what comes from now on is late
                stage.relay.release()
                if ending.does is _freeze:
                    bridge.command.signal(signal.SIGCONT)
                if stage.router is not None and ending.does is _router_stopped:
                    stage.router.go_on()
            time.sleep(_WATCHED - 1.0)
        return _judge(stage, began, within)


def _await_motion(stage: Stage, holder: Command) -> list[Arrival]:
    try:
        return eventually(lambda: _three([each for each in stage.heard() if each.number]), 30, "it moves")
    except AssertionError as error:
        raise AssertionError(f"{error}; {holder.code} {holder.output[-300:]}; {stage.describe()}") from None


def _three(moving: list[Arrival]) -> list[Arrival] | None:
    return moving if len(moving) >= 3 else None


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

    def drive() -> None:
        ticket = 0
        while not over.wait(1 / _KEYS):
            try:
                published = bridge.console.publish(
                    TOPIC, f"linear: {{x: {VELOCITY}}}", _ENTRY["type"], ticket=ticket, rest="{}"
                ).result(5)
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
