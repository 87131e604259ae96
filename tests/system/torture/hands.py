"""Keys that a hung line delivers late: what they do to a robot, counted at a ROS node of its domain.

``python -m tests.system.torture.hands [CASE ...] [--hang SECONDS] [--program RSB-CONSOLE]``

An operator's terminal, emulated here, is connected to a console by a process that passes bytes on, as sshd does. The
console runs in that process's pseudo-terminal, or in tmux (``behind-tmux``). It is attached to the control PC's bridge.
The process is stopped (SIGSTOP), keys are typed, and the process goes on some seconds later. Before, the same keys move
the robot, arm its topic, or publish: a case in which they do not is no proof.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import yaml
from tests.support.locks import two_domains
from tests.support.ports import free_port
from tests.support.waiting import eventually
from tests.system.torture.terminal import Terminal

from rsb_bridge.api import EngineError
from rsb_bridge.config.keys import write_key
from rsb_bridge.control.remote_engine import RemoteEngine

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.model.snapshot import RouteSnapshot

Place = Literal["direct", "behind-tmux"]
TOPIC = "/cmd_vel"
UP = "\x1b[A"
_ROOT = Path(__file__).parents[3]
PROGRAM = Path(sys.executable).with_name("rsb-console")
_RESTS = 2.0
"""s without a message after which the robot counts as at rest."""
_CLICKS = "".join(f"\x1b[<0;{x};{y}M\x1b[<0;{x};{y}m" for y in range(10, 30) for x in range(40, 60, 4))


class Case(NamedTuple):
    """Keys that are typed while the line hangs.

    Attributes:
        keys: as the terminal sends them.
        armed: whether the topic is armed meanwhile, with the drive screen open; otherwise its list of topics is shown.
    """

    keys: str
    armed: bool


CASES = {
    "1 key": Case("i", armed=True),
    "3 keys": Case("iii", armed=True),
    "9 keys": Case("i" * 9, armed=True),
    "held for 8 s": Case("i" * 240, armed=True),
    "3 arrows": Case(UP * 3, armed=True),
    "paste": Case("\x1b[200~iii\x1b[201~", armed=True),
    "paste, as keys": Case("iij", armed=True),
    "arm and drive": Case("DA\t\riii", armed=False),
    "arm by y and drive": Case("DAyiii", armed=False),
    "arm": Case("Ay", armed=False),
    "arm, by the mouse": Case("A" + _CLICKS, armed=False),
    "remove": Case("dy", armed=False),
}
PLACES: tuple[Place, ...] = ("direct", "behind-tmux")


class Result(NamedTuple):
    """The effect of late keys.

    Attributes:
        moving: messages with a velocity that the robot got.
        messages: all messages that it got.
        armed: whether the topic was armed.
        removed: whether it was removed.
        problem: the reason why the case proves nothing, or an empty string.
    """

    moving: int
    messages: int
    armed: bool
    removed: bool
    problem: str = ""

    @property
    def is_harmless(self) -> bool:
        return not (self.moving or self.messages or self.armed or self.removed or self.problem)


def listen(domain: int, file: str) -> int:
    """Write each velocity that reaches the robot to a file."""
    import rclpy
    from geometry_msgs.msg import Twist

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("motors", context=context)
    with Path(file).open("a", buffering=1) as lines:
        node.create_subscription(
            Twist,
            TOPIC,
            lambda twist: lines.write(f"{time.monotonic()} {twist.linear.x} {twist.angular.z}\n"),
            10,
        )
        executor = rclpy.executors.SingleThreadedExecutor(context=context)
        executor.add_node(node)
        lines.write("ready\n")
        executor.spin()
    return 0


class Bed:
    """A robot with a listener, a control PC's bridge, and an operator's console on it.

    Args:
        place: where the console runs.
    """

    def __init__(self, place: Place, folder: Path, program: Path) -> None:
        self._place, self._folder, self._program = place, folder, program
        self._resources = contextlib.ExitStack()
        self._heard = folder / "heard"
        self.engine: RemoteEngine
        self.terminal: Terminal

    def __enter__(self) -> Bed:
        with contextlib.ExitStack() as undo:
            undo.callback(self._resources.close)
            self._start()
            undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()

    def _start(self) -> None:
        robot = two_domains()
        port = free_port()
        write_key(self._folder / "key.txt")
        common = {"name": "robot1", "key_file": "key.txt", "server_ip": "127.0.0.1", "server_port": port}
        entry = {
            "topic": TOPIC, "direction": "receive", "type": "geometry_msgs/msg/Twist", "arm": True, "deadman": 0,
            "protocol": "tcp",
        }  # fmt: skip
        sessions = {
            "pc": common | {"role": "server", "domain_id": robot + 1},
            "robot": common | {"role": "client", "domain_id": robot, "topics": [entry]},
        }
        for name, session in sessions.items():
            (self._folder / f"{name}.yaml").write_text(yaml.safe_dump(session, sort_keys=False))
            self._spawn(str(self._program), "run", f"{name}.yaml", "--no-ui", "--control", f"{name}.sock")
        self._spawn(sys.executable, "-m", "tests.system.torture.hands", "--listen", str(robot), str(self._heard))
        eventually(self._heard.exists, what="the listener")
        self.engine = eventually(self._attached, 120, "the control PC's bridge")
        self._resources.callback(self.engine.stop)
        eventually(lambda: (route := self.route()) is not None and route.state == "disarmed", 120, "the route")
        command = [str(self._program), "attach", "--control", str(self._folder / "pc.sock")]
        if self._place == "behind-tmux":
            socket = str(self._folder / "tmux")
            tmux = ["tmux", "-S", socket, "-f", "/dev/null"]
            subprocess.run([*tmux, "new-session", "-d", "-x", "120", "-y", "36", *command], check=True)
            self._resources.callback(subprocess.run, [*tmux, "kill-server"], check=False)
            subprocess.run([*tmux, "set-option", "-g", "mouse", "on"], check=True)
            command = [*tmux, "attach"]
        self.terminal = Terminal(*command)
        self._resources.callback(self.terminal.close)
        try:
            eventually(lambda: self.terminal.shows(TOPIC), 120, "the console")
        except AssertionError:
            log = (self._folder / "log").read_text(errors="replace")[-2000:]
            raise AssertionError(f"the console is not drawn: {self.terminal.state()}\n{log}") from None
        time.sleep(3)  # a terminal's kind, and its first answers

    def _spawn(self, *command: str) -> None:
        with (self._folder / "log").open("ab") as log:
            process = subprocess.Popen(command, cwd=self._folder, stdout=log, stderr=log, env=self._environ())
        self._resources.callback(process.wait)
        self._resources.callback(process.terminate)

    def _environ(self) -> dict[str, str]:
        path = [str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
        return os.environ | {"PYTHONPATH": os.pathsep.join(path)}

    def _attached(self) -> RemoteEngine | None:
        engine = RemoteEngine(self._folder / "pc.sock")
        try:
            engine.start()
        except EngineError:
            return None
        return engine

    # --- the robot

    def route(self) -> RouteSnapshot | None:
        return next((each for each in self.engine.snapshot().routes if each.topic == TOPIC), None)

    @property
    def armed(self) -> bool:
        route = self.route()
        return route is not None and route.arming is not None and route.arming.armed

    def heard(self, since: float) -> list[tuple[float, float, float]]:
        """Times and velocities of the messages that have come since then."""
        lines = [each.split() for each in self._heard.read_text().splitlines() if " " in each]
        found = [(float(at), float(forward), float(turn)) for at, forward, turn in lines]
        return [each for each in found if each[0] >= since]

    def await_rest(self) -> None:
        began = time.monotonic()
        eventually(lambda: time.monotonic() - max([began, *(each[0] for each in self.heard(0.0))]) > _RESTS, 60, "rest")

    # --- the operator

    def _try(self, what: str, act: Callable[[], None], holds: Callable[[], bool], times: int = 6) -> None:
        for _ in range(times):
            act()
            with contextlib.suppress(AssertionError):
                eventually(holds, 4.0, what)
                return
        raise AssertionError(f"not {what}")

    def to_list(self) -> None:
        """Close all screens, and disarm."""
        for _ in range(4):
            self.terminal.type("\x1b")
            time.sleep(0.3)
        route = self.route()
        if route is not None and self.armed:
            self.engine.disarm(route.key).result(10)
        eventually(lambda: (route := self.route()) is not None and route.state == "disarmed", 60, "disarmed")

    def arm_and_drive(self) -> None:
        """Open the drive screen, arm the topic, and drive a moment, all by keys."""
        self.terminal.type("D")
        time.sleep(1.0)

        def arm() -> None:
            self.terminal.type("A")
            time.sleep(1.5)
            self.terminal.type("y")

        self._try("armed by keys", arm, lambda: self.armed)
        began = time.monotonic()

        def drive() -> None:
            if not self.armed:  # on a busy machine its lease may end
                arm()
                time.sleep(1.0)
            for _ in range(2):
                self.terminal.type("i")
                time.sleep(0.4)

        self._try("driven by keys", drive, lambda: any(each[1] > 0 for each in self.heard(began)))
        self.await_rest()

    def late(self, case: Case, hang: float) -> Result:
        """Type keys while the line hangs; return what they did.

        A bridge that stands still for a second on a busy machine ends an arming. Then the keys are typed once more, and
        what the first ones did counts, too.
        """
        heard: list[tuple[float, float, float]] = []
        for _ in range(6):
            self.to_list()
            if case.armed:
                self.arm_and_drive()
            began = time.monotonic()
            with self.terminal.hung():
                self.terminal.type(case.keys)
                time.sleep(hang)
            lost = case.armed and not self.armed
            armed = False
            for _ in range(80):
                armed |= self.armed
                time.sleep(0.05)
            # An arming that has ended brings the robot to rest.
            heard += [each for each in self.heard(began) if not lost or each[1] or each[2]]
            if not lost or armed:
                break
        else:
            return Result(0, 0, armed=False, removed=False, problem="disarmed meanwhile")
        moving = sum(bool(forward or turn) for _, forward, turn in heard)
        armed, removed = armed and (lost or not case.armed), self.route() is None
        self.to_list()
        return Result(moving, len(heard), armed, removed)


def run(names: list[str], places: list[Place], hang: float, program: Path) -> Iterator[tuple[Place, str, Result]]:
    """Play cases; yield the result of each."""
    for place in places:
        with tempfile.TemporaryDirectory(prefix="rsb-hands-") as folder, Bed(place, Path(folder), program) as bed:
            for name in names:
                try:
                    result = bed.late(CASES[name], hang)
                except AssertionError as error:
                    result = Result(0, 0, armed=False, removed=False, problem=str(error))
                yield place, name, result
                if result.removed:
                    break


def main() -> int:
    """Run the command; the exit code is 1 if a late key did something."""
    if sys.argv[1:2] == ["--listen"]:
        return listen(int(sys.argv[2]), sys.argv[3])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--hang", type=float, default=8.0, metavar="SECONDS")
    parser.add_argument("--place", choices=PLACES, action="append")
    parser.add_argument("--program", type=Path, default=PROGRAM, help="rsb-console of another version")
    arguments = parser.parse_args()
    print(f"{'keys':22}{'console':14}{'moving':>8}{'messages':>10}{'armed':>8}{'removed':>9}")  # noqa: T201
    wrong = 0
    names, places = arguments.names or [*CASES], arguments.place or [*PLACES]
    for place, name, result in run(names, places, arguments.hang, arguments.program.absolute()):
        figures = f"{result.moving:>8}{result.messages:>10}{result.armed!s:>8}{result.removed!s:>9}"
        print(f"{name:22}{place:14}{figures}  {result.problem}", flush=True)  # noqa: T201
        wrong += not result.is_harmless
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
