"""Attacks on a bridge whose topic is armed. Afterwards it is disarmed, armed, and disarmed once more."""

from __future__ import annotations

import random
import time
from collections import Counter
from typing import TYPE_CHECKING

from tests.support.relay import STREAMS
from tests.system.torture.stage import RATE, TOPIC, Stage
from tests.system.torture.threads import stopped

from rsb_bridge.api import EngineError
from rsb_bridge.route.lease import SLOW

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import TypeAlias

    from tests.support.relay import Stream
    from tests.system.torture.judge import Findings
    from tests.system.torture.stage import Bridge, Nodes, Side, Transport

    Attack: TypeAlias = Callable[[Stage], None]

STAYS_ARMED = "stays armed"
"""A note of a case: the attack has not disarmed the topic, which is right if no old message crosses."""
NOT_AGAIN = "cannot be armed again"
FREEZE = 8.0
HOLD = 4.0
_STREAM_GAP = 0.3
_TRIES = 10
_TRY_AGAIN_AFTER = 0.2


def freeze_robot(stage: Stage, seconds: float = FREEZE) -> None:
    """The robot's bridge stands still, as on a machine that swaps."""
    with stage.robot.frozen():
        time.sleep(seconds)


def freeze_robot_often(stage: Stage, times: int = 30) -> None:
    """It stands still at random moments: one may lie between its look at the clock and its publishing."""
    choice = random.Random(1)
    for number in range(times):
        freeze_robot(stage, 1.5)
        stage.disarm().wait(30)
        stage.disarmed()
        stage.await_disarmed()
        stage.arm_and_flow(by=(stage.pc, stage.robot)[number % 2])  # a side's operators may arm 20 times in a row
        time.sleep(choice.uniform(0.0, 0.1))


def freeze_pc(stage: Stage, seconds: float = FREEZE) -> None:
    """The control PC's bridge stands still."""
    with stage.pc.frozen():
        time.sleep(seconds)


def briefly(freeze: Callable[[Stage, float], None]) -> Attack:
    """A bridge stands still for less than the link takes to notice."""

    def attack(stage: Stage) -> None:
        for _ in range(3):
            freeze(stage, 2.0)
            time.sleep(0.5)

    return attack


def hold(order: Sequence[Stream], seconds: float = HOLD) -> Attack:
    """The network holds everything, and releases one stream after another."""

    def attack(stage: Stage) -> None:
        stage.relay.hold()
        time.sleep(seconds)
        for stream in order:
            stage.relay.release((stream,))
            time.sleep(_STREAM_GAP)
        stage.relay.release()

    return attack


def hold_briefly(stage: Stage) -> None:
    """The network holds everything for 0.9 s, again and again."""
    for _ in range(5):
        stage.relay.hold()
        time.sleep(0.9)
        stage.relay.release()
        time.sleep(0.4)


def hold_data_only(stage: Stage) -> None:
    """The network holds the commands alone: everything else tells both sides that all is well."""
    for seconds in (0.9, 1.5, 3.0):
        stage.relay.hold(("data", "datagrams"))
        time.sleep(seconds)
        stage.relay.release()
        time.sleep(0.5)


def hold_control_only(stage: Stage) -> None:
    """The network holds the control connection alone."""
    stage.relay.hold(("control",))
    time.sleep(HOLD)
    stage.relay.release()


def add_up(stage: Stage) -> None:
    """The control PC's bridge stands still for 0.8 s, and then the network holds for 0.8 s: each is allowed."""
    for _ in range(3):
        with stage.pc.frozen():
            time.sleep(0.8)
        stage.relay.hold()
        time.sleep(0.8)
        stage.relay.release()
        time.sleep(0.5)


def disarm_while_held(stage: Stage) -> None:
    """An operator disarms while the network holds everything."""
    stage.relay.hold()
    time.sleep(0.7)
    command = stage.disarm()
    command.wait(30)
    stage.disarmed()
    time.sleep(1.0)
    for stream in ("data", "datagrams", "control"):
        stage.relay.release((stream,))
        time.sleep(_STREAM_GAP)


def disarm_while_held_in_part(*streams: Stream) -> Attack:
    """An operator disarms while the network holds the commands alone, or the control connection alone."""

    def attack(stage: Stage) -> None:
        stage.relay.hold(streams)
        time.sleep(0.5)
        stage.disarm().wait(30)
        stage.disarmed()
        time.sleep(0.5)
        stage.relay.release()

    return attack


def disarm_while_frozen(stage: Stage) -> None:
    """An operator disarms while the robot's bridge stands still."""
    with stage.robot.frozen():
        time.sleep(0.5)
        stage.disarm().wait(30)
        stage.disarmed()
        time.sleep(1.0)


def disarm_at_once(side: Side) -> Attack:
    """Disarm on a network that takes 0.4 s: messages in flight are published before the answer, or never."""

    def attack(stage: Stage) -> None:
        stage.relay.delay = lambda: 0.4
        time.sleep(1.0)
        stage.disarm(stage.side(side)).wait(30)
        stage.disarmed()
        time.sleep(1.0)
        stage.relay.delay = lambda: 0.0

    return attack


def stop_thread(side: Side, name: str) -> Attack:
    """One thread stands still (`ros` takes messages from ROS, `rsb-io` is the event loop); the others go on."""

    def attack(stage: Stage) -> None:
        with stopped(stage.side(side).command.pid, name):
            time.sleep(5.0)

    return attack


def crawl(side: Side) -> Attack:
    """Give a bridge 30 ms of a processor, and then none for 0.8 s, again and again."""

    def attack(stage: Stage) -> None:
        deadline = time.monotonic() + 10.0
        while time.monotonic() < deadline:
            with stage.side(side).frozen():
                time.sleep(0.8)
            time.sleep(0.03)

    return attack


def crawl_ros_of_pc(stage: Stage) -> None:
    """Stop the control PC's ROS thread for 0.8 s, again and again."""
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:
        with stopped(stage.pc.command.pid, "ros"):
            time.sleep(0.8)
        time.sleep(0.005)


def stop_router(stage: Stage) -> None:
    """The Zenoh router stands still, and goes on."""
    assert stage.router is not None
    for seconds in (2.0, 6.0):
        stage.router.pause()
        time.sleep(seconds)
        stage.router.go_on()
        time.sleep(1.0)


def kill_router(stage: Stage) -> None:
    """The Zenoh router is killed, and started again."""
    assert stage.router is not None
    stage.router.kill()
    time.sleep(1.0)
    stage.router.start()


def kill_robot(stage: Stage) -> None:
    """The robot's bridge is killed, and started again."""
    stage.robot.kill()
    stage.robot.start()


def kill_pc(stage: Stage) -> None:
    """The control PC's bridge is killed, and started again."""
    stage.pc.kill()
    stage.disarmed()  # no console shows anything armed
    stage.pc.start()


def kill_console(stage: Stage) -> None:
    """The console that armed the topic is killed while the network holds everything."""
    stage.disarm().wait(30)
    stage.disarmed()
    stage.await_disarmed()
    window = stage.begin_window()
    holder = stage.pc.run("arm", TOPIC)
    stage.await_flow(window)
    stage.relay.hold()
    time.sleep(0.5)
    holder.kill()
    time.sleep(3.0)
    for stream in ("data", "datagrams", "control"):
        stage.relay.release((stream,))
        time.sleep(_STREAM_GAP)


def arm_and_disarm(stage: Stage, rounds: int = 36, seed: int = 1) -> None:
    """Arm and disarm quickly over a network with delays at random, with which round trips are just short enough."""
    choice = random.Random(seed)
    stage.relay.delay = lambda: choice.uniform(0.0, SLOW / 2 - 0.03)
    sides = [stage.robot, stage.pc] * (rounds // 2)  # a side's operators may arm 20 times in a row
    choice.shuffle(sides)
    refused: Counter[str] = Counter()
    for side in sides:
        bridge = choice.choice((stage.pc, stage.robot))
        bridge.console.disarm(bridge.routes()[0].key).result(30)
        stage.disarmed()
        stage.await_disarmed()
        _arm_at_last(stage, side, refused)
        time.sleep(choice.uniform(0.0, 1.0))
    stage.relay.delay = lambda: 0.0
    if refused:
        stage.notes.append(f"refused: {dict(refused)}")


def _arm_at_last(stage: Stage, side: Bridge, refused: Counter[str]) -> None:
    """Arm, again and again while it is refused, as the topic may still be being set up on one side."""
    for _ in range(_TRIES):
        try:
            stage.arm(side)
        except EngineError as error:
            refused[str(error)] += 1
            time.sleep(_TRY_AGAIN_AFTER)
        else:
            return


ATTACKS: dict[str, Attack] = {
    "none": lambda _: time.sleep(1.0),
    "freeze-robot": freeze_robot,
    "freeze-robot-often": freeze_robot_often,
    "freeze-pc": freeze_pc,
    "freeze-robot-2s": briefly(freeze_robot),
    "freeze-pc-2s": briefly(freeze_pc),
    "hold-data-first": hold(("data", "datagrams", "control")),
    "hold-control-first": hold(("control", "datagrams", "data")),
    "hold-datagrams-first": hold(("datagrams", "data", "control")),
    "hold-0.9s": hold_briefly,
    "hold-data-only": hold_data_only,
    "hold-control-only": hold_control_only,
    "add-up": add_up,
    "disarm-held": disarm_while_held,
    "disarm-data-held": disarm_while_held_in_part("data", "datagrams"),
    "disarm-control-held": disarm_while_held_in_part("control"),
    "disarm-frozen": disarm_while_frozen,
    "disarm-0.4s": disarm_at_once("pc"),
    "disarm-robot-0.4s": disarm_at_once("robot"),
    "ros-thread-pc": stop_thread("pc", "ros"),
    "ros-thread-robot": stop_thread("robot", "ros"),
    "loop-pc": stop_thread("pc", "rsb-io"),
    "loop-robot": stop_thread("robot", "rsb-io"),
    "crawl-pc": crawl("pc"),
    "crawl-robot": crawl("robot"),
    "crawl-ros-thread-pc": crawl_ros_of_pc,
    "router-stopped": stop_router,
    "router-killed": kill_router,
    "kill-robot": kill_robot,
    "kill-pc": kill_pc,
    "kill-console": kill_console,
    "arm-disarm": arm_and_disarm,
}

_BY_STREAM = {"hold-data-first", "hold-control-first", "hold-datagrams-first", "hold-data-only", "hold-control-only"}
_BY_STREAM |= {"disarm-data-held", "disarm-control-held"}
"""Over Zenoh all streams share one connection."""


def fits(name: str, transport: Transport) -> bool:
    """Whether an attack is possible over a transport, and differs from another one there."""
    if transport.startswith("zenoh"):
        return name not in _BY_STREAM - {"hold-data-first"}
    return not name.startswith("router") and not (name == "hold-datagrams-first" and transport == "tcp")


def _stepped(side: Side, seconds: float) -> Callable[[Nodes], Attack]:
    def bound(nodes: Nodes) -> Attack:
        def attack(stage: Stage) -> None:
            nodes.clocks[side].set(seconds)
            hold(("data", "datagrams", "control"), 2.0)(stage)

        return attack

    return bound


STEPS = {
    "step-pc-ahead": _stepped("pc", 10.0),
    "step-pc-back": _stepped("pc", -10.0),
    "step-robot-ahead": _stepped("robot", 10.0),
    "step-robot-back": _stepped("robot", -10.0),
}
"""A wall clock is stepped, and then the network holds for 2 s. Only with `Nodes.clocks`."""


def attack(nodes: Nodes, name: str, transport: Transport, work: Attack | None = None) -> Findings:
    """Do one attack, and judge what reached the robot.

    Args:
        name: of `ATTACKS`.
        work: instead of the attack of that name.
    """
    for clock in nodes.clocks.values():
        clock.set(0.0)
    if name in STEPS:
        work = STEPS[name](nodes)
    with Stage(nodes, transport) as stage:
        stage.prepare()
        stage.arm_and_flow(int(RATE / 2))
        (work or ATTACKS[name])(stage)
        notes = []
        if stage.windows[-1].shown is None:
            time.sleep(1.0)
        if stage.windows[-1].shown is None:
            notes.append(STAYS_ARMED)
            stage.disarm().wait(30)
            stage.disarmed()
        time.sleep(1.0)
        stage.relay.release(STREAMS)
        try:
            stage.await_disarmed(30)
            stage.arm_and_flow()
            stage.disarm().wait(30)
            stage.disarmed()
        except (AssertionError, EngineError) as error:
            notes.append(f"{NOT_AGAIN}: {error}")
        stage.settle()
        found = stage.findings()
        found.notes += stage.notes + notes
        return found
