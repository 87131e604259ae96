"""Keys that a hung line delivers late: what they do to a robot, counted at a ROS node of its domain.

``python -m tests.system.torture.hands [CASE ...] [--hang SECONDS]``

An operator's terminal, emulated here, is connected to a console by a process that passes bytes on, as sshd does. The
console runs in that process's pseudo-terminal, in tmux (``behind-tmux``), or in a terminal that answers nothing
(``mute``). It is attached to the control PC's bridge. The process is stopped (SIGSTOP), keys are typed, and the process
goes on some seconds later, or they come then in several parts. Before, a held key moves the robot: a case in which it
does not is no proof.

With ``mosh``, a line with a round trip of 0.2 s lies between them, and nothing passes on it meanwhile. With
``dtach-mosh``, the console runs in dtach. The terminal itself was attached to that first, and then it is by mosh.
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from tests.support.locks import two_domains
from tests.support.waiting import eventually
from tests.system.torture.mosh import Mosh
from tests.system.torture.stage import TOPIC, TWIST, Nodes, Stage
from tests.system.torture.terminal import Terminal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from tests.system.torture.ends import Arrival

    from rsb_bridge.model.snapshot import RouteSnapshot

Place = Literal["direct", "behind-tmux", "mute", "mosh", "dtach-mosh"]
UP = "\x1b[A"
_PROGRAM = Path(sys.executable).with_name("rsb-console")
_RESTS = 2.0
"""s without a message after which the robot counts as at rest."""
_CLICKS = "".join(f"\x1b[<0;{x};{y}M\x1b[<0;{x};{y}m" for y in range(10, 30) for x in range(40, 60, 4))


class Case(NamedTuple):
    """Keys that are typed while the line hangs.

    Attributes:
        keys: as the terminal sends them.
        armed: whether the topic is armed meanwhile, with the drive screen open; otherwise its list of topics is shown.
        before: keys that are typed before, in time.
        parts: in which they come.
        apart: s between these.
    """

    keys: str
    armed: bool
    before: str = ""
    parts: int = 1
    apart: float = 0.0


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
    **{
        f"{count} in {parts}, {apart:g} s": Case("i" * count, armed=True, parts=parts, apart=apart)
        for count, parts in ((3, 3), (6, 2), (6, 3), (9, 3))
        for apart in (0.1, 0.2, 0.3, 0.5)
    },
    "y to a question": Case("y", armed=False, before="A"),
    "yy to a question": Case("yy", armed=False, before="A"),
}
PLACES: tuple[Place, ...] = ("direct", "behind-tmux", "mute", "mosh", "dtach-mosh")
TOOLS = {"behind-tmux": ["tmux"], "mosh": ["mosh-server"], "dtach-mosh": ["mosh-server", "dtach"]}
"""Programs that places need."""
_READ_FOR = 2.0
"""s in which a question is drawn and names its keys."""
_HELD_FOR, _REPEAT_EVERY, _REPEATS = 0.5, 0.04, 30
"""s until a held key repeats, and then from one to the next: X11's; and their number."""


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


class Bed:
    """A robot with a listener, a control PC's bridge, and an operator's console on it.

    Args:
        place: where the console runs.
        round_trip: s of mosh's line.
    """

    def __init__(self, place: Place, folder: Path, round_trip: float = 0.2) -> None:
        with contextlib.ExitStack() as resources:
            nodes = Nodes.start(folder, two_domains())
            resources.callback(nodes.close)
            self._stage = resources.enter_context(Stage(nodes, entry=TWIST))
            self._stage.prepare(twist=True, talks=False)
            command = [str(_PROGRAM), "attach", "--control", str(self._stage.pc.control)]
            if place == "behind-tmux":
                tmux = ["tmux", "-S", str(folder / "tmux"), "-f", "/dev/null"]
                subprocess.run([*tmux, "new-session", "-d", "-x", "120", "-y", "36", *command], check=True)
                resources.callback(subprocess.run, [*tmux, "kill-server"], check=False)
                subprocess.run([*tmux, "set-option", "-g", "mouse", "on"], check=True)
                command = [*tmux, "attach"]
            if place == "dtach-mosh":
                socket = folder / "dtach"
                master = subprocess.Popen(["dtach", "-N", str(socket), *command], stdin=subprocess.DEVNULL)
                resources.enter_context(master)
                resources.callback(master.terminate)
                eventually(socket.exists, what="dtach")
                command = ["dtach", "-a", str(socket)]
                with contextlib.closing(Terminal(*command)) as self.terminal:
                    self._await_console()
            self._mosh: Mosh | None = None
            environ: Mapping[str, str] = {}
            if place in ("mosh", "dtach-mosh"):
                self._mosh = resources.enter_context(Mosh(*command, round_trip=round_trip))
                command, environ = self._mosh.client
            self.terminal = Terminal(*command, mute=place == "mute", environ=environ)
            resources.callback(self.terminal.close)
            self._await_console()
            self._resources = resources.pop_all()

    def __enter__(self) -> Bed:
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()

    def _await_console(self) -> None:
        try:
            eventually(lambda: self.terminal.shows(TOPIC), what="the console")
        except AssertionError:
            raise AssertionError(f"the console is not drawn: {self.terminal.state()}") from None
        time.sleep(3)  # a terminal's kind, and its first answers

    # --- the robot

    def route(self) -> RouteSnapshot | None:
        return next(iter(self._stage.pc.routes()), None)

    @property
    def armed(self) -> bool:
        route = self.route()
        return route is not None and route.arming is not None and route.arming.armed

    def heard(self, since: float) -> list[Arrival]:
        """Return the messages that have come since then. A message that moves the robot has another number than 0."""
        return [each for each in self._stage.heard() if each.arrived >= since]

    def await_rest(self) -> None:
        began = time.monotonic()
        eventually(lambda: (now := time.monotonic()) > began + _RESTS and not self.heard(now - _RESTS), what="rest")

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
            self._stage.pc.console.disarm(route.key).result(60)
        eventually(lambda: (route := self.route()) is not None and route.state == "disarmed", what="disarmed")

    def arm_and_drive(self) -> None:
        """Open the drive screen, arm the topic, and drive a moment, all by keys."""
        self.terminal.type("D")
        time.sleep(1.0)

        def arm() -> None:
            self.terminal.type("A")
            time.sleep(1.5)
            self.terminal.type("y")
            time.sleep(1.0)
            self.terminal.type("y")  # if a busy machine has drawn the question late

        self._try("armed by keys", arm, lambda: self.armed)
        began = time.monotonic()

        def drive() -> None:
            if not self.armed:  # on a busy machine its lease may end
                arm()
                time.sleep(1.0)
            self.terminal.type("i")
            time.sleep(_HELD_FOR)
            for _ in range(_REPEATS):
                self.terminal.type("i")
                time.sleep(_REPEAT_EVERY)

        self._try("driven by keys", drive, lambda: any(each.number for each in self.heard(began)))
        self.await_rest()

    def hold(self, seconds: float) -> list[Arrival]:
        """Hold a key for some seconds, and return what the robot got until it was at rest."""
        began = time.monotonic()
        self.terminal.type("i")
        due = began + _HELD_FOR
        while due < began + seconds:
            time.sleep(max(0.0, due - time.monotonic()))
            self.terminal.type("i")
            due += _REPEAT_EVERY
        self.await_rest()
        return self.heard(began)

    def late(self, case: Case, hang: float) -> Result:
        """Type keys while the line hangs; return what they did.

        A bridge that stands still for a second on a busy machine ends an arming. Then the keys are typed once more, and
        what the first ones did counts, too.
        """
        heard: list[Arrival] = []
        for _ in range(6):
            self.to_list()
            if case.armed:
                self.arm_and_drive()
            if case.before:
                self.terminal.type(case.before)
                time.sleep(_READ_FOR)
            began = time.monotonic()
            with self.terminal.hung() if self._mosh is None else self._mosh.hung():
                if case.parts == 1:
                    self.terminal.type(case.keys)
                time.sleep(hang)
            if case.parts > 1:
                self.terminal.type_late(case.keys, case.parts, case.apart)
            lost = case.armed and not self.armed
            armed = False
            for _ in range(80):
                armed |= self.armed
                time.sleep(0.05)
            # An arming that has ended brings the robot to rest.
            heard += [each for each in self.heard(began) if not lost or each.number]
            if not lost or armed:
                break
        else:
            return Result(0, 0, armed=False, removed=False, problem="disarmed meanwhile")
        moving = sum(bool(each.number) for each in heard)
        armed, removed = armed and (lost or not case.armed), self.route() is None
        self.to_list()
        return Result(moving, len(heard), armed, removed)


def run(names: list[str], places: list[Place], hang: float) -> Iterator[tuple[Place, str, Result]]:
    """Play cases; yield the result of each."""
    for place in places:
        with tempfile.TemporaryDirectory(prefix="rsb-hands-") as folder, Bed(place, Path(folder)) as bed:
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--hang", type=float, default=8.0, metavar="SECONDS")
    parser.add_argument("--place", choices=PLACES, action="append")
    arguments = parser.parse_args()
    print(f"{'keys':22}{'console':14}{'moving':>8}{'messages':>10}{'armed':>8}{'removed':>9}")  # noqa: T201
    wrong = 0
    names, places = arguments.names or [*CASES], arguments.place or [*PLACES]
    for place, name, result in run(names, places, arguments.hang):
        figures = f"{result.moving:>8}{result.messages:>10}{result.armed!s:>8}{result.removed!s:>9}"
        print(f"{name:22}{place:14}{figures}  {result.problem}", flush=True)  # noqa: T201
        wrong += not result.is_harmless
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
