"""Prints what the console costs an operator's line, and how late its screen is: ``python -m bench.operator_line``.

A robot and a desk are simulated in two ROS domains, a bridge of two processes stands between them, and
``rsb-console attach`` runs at the desk in a terminal of 80×24 (`bench.slow_terminal`). Parts, by name; all without one:

- ``rest``: bytes a second that the console sends, by terminal and by what it shows;
- ``keys``: s from a key until the screen behind a line of some bytes a second shows the first part of its effect, which
  tells what the key did (title and first lines of the help, title and state of the box that drives, question and both
  answers), and the whole;
- ``mosh``: the same with mosh over a path that delays and loses packets (``apt install mosh``);
- ``peers``: bytes a second at rest, and bytes for a cursor key, beside ``htop``, if it is installed, and the programs
  of ``--peer NAME=COMMAND``.

``--other FOLDER`` measures another checkout by turns, with the Python of its ``.venv`` if it has one, and prints how
many times as much it takes.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import re
import shlex
import shutil
import signal
import statistics
import subprocess
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench import bed
from bench.line_bed import Checkout, Side
from bench.slow_terminal import KINDS, NEVER, NotShownError, SlowTerminal
from tests.support.relay import Relay

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Iterator, Mapping, Sequence

    Shows = Callable[[Sequence[str]], bool]

RATES = (960, 1_920, 11_520, 0)
"""Bytes/s: serial lines of 9,600, 19,200 and 115,200 baud, and no limit."""
ROUNDS, WITHIN = 5, 30.0
REST = 10.0
"""s of a measurement at rest."""
_SETTLES = 3.0
_FULL_AFTER, _QUIET_AFTER = 6.0, 1.0
"""s before a key, with a limit and without: what is written into a full line waits by then."""
_SLOW_AFTER = 15.0
"""s from the limit on, until what was written to the fast line before has left."""
_TRIES, _AGAIN_AFTER = 10, 2.0
"""Presses of a key that may come too early to count, and s until the next one."""
_PATHS = tuple(product((0.06, 0.2), (0.0, 0.05)))
"""Round trips, s, and parts of the packets that are lost each way."""
_CURSOR_KEYS, _KEY_SHOWN = 10, 0.1
"""Keys, and s from the first byte of their effect until all of it has been written."""

_HELP, _DISARMED = "Help: every key", "press A to arm it"
_QUESTION, _ARMED, _MOVES = "Arm /cmd_vel of", "armed, for", "forward +"
_ANSWERS = re.compile(r"Arm +No")


class Scene(NamedTuple):
    """A screen of the console.

    Attributes:
        opens: the keys that open it from the main screen, each with the text that shows their effect.
        first: a text of its first line.
        last: a text of its last line, which is drawn last.
        drives: the key of the box that drives.
        help: texts of the first two lines, and of the last, of the help for it.
    """

    name: str
    opens: tuple[tuple[str, str], ...]
    first: str = ""
    last: str = ""
    drives: str = "D"
    help: tuple[str, str, str] = ("", "", "")


def _layout(name: str, text: str) -> tuple[tuple[str, str], ...]:
    return ("V", "type to search"), (name, f"layout {name}"), ("\r", text)


_Took = dict[str, list[list[float]]]
"""s of the first part and of the whole of each key's effect, of each time that it was pressed."""

MAIN = Scene("main screen", (), "LINKED", "? help  q quit", help=("Next line", "Previous line", "previous_match"))
DRIVE = Scene("drive box, no key", (("D", _DISARMED),))
SILENT = Scene("two tiles, no picture", _layout("two-silent", "publisher"))
CAMERA = Scene(
    "camera",
    _layout("one-camera", "/camera/image_raw"),
    "/camera/image_raw",
    " d drive ",
    "d",
    ("Tiles (V", "Add a tile", "Of a map"),
)
RESTING = (
    *((kind, scene, rate) for kind in ("24bit", "256", "vt220") for scene in (MAIN, DRIVE) for rate in (4.0, 0.5)),
    *((kind, scene, 4.0) for kind in ("24bit", "256", "vt220") for scene in (SILENT, CAMERA)),
    ("sixel", CAMERA, 4.0),
    ("kitty", CAMERA, 4.0),
)
"""Terminals, scenes and refreshes a second."""
KEYS = ("help", "help gone", "drive box", "arm question", "forward")
_PARTS = "p50 and worst of the first part that tells what the key did, and of the whole,"


def main() -> None:
    """Measure what the command line asks for."""
    options = _options()
    checkouts = [Checkout(bed.ROOT, "this")]
    if options.other is not None:
        checkouts.append(Checkout(options.other.absolute(), "other"))
    with contextlib.ExitStack() as stack:
        sides = []
        for number, checkout in enumerate(checkouts):
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="line")))
            sides.append(stack.enter_context(Side(checkout, options.domain + 2 * number, folder)))
        print(f"load average {os.getloadavg()[0]:.1f}; terminals of 80×24")
        for part in options.parts or PARTS:
            PARTS[part](sides, options)


def _options() -> Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench.operator_line")
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="all without one", metavar="|".join(PARTS))
    parser.add_argument("--other", type=Path, metavar="FOLDER", help="another checkout, measured by turns")
    parser.add_argument("--domain", type=int, default=bed.NEAR, metavar="N", help="first of two ROS domains of a side")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="times that each key is pressed")
    parser.add_argument("--within", type=float, default=WITHIN, metavar="S", help="for how long a key is waited for")
    parser.add_argument("--rates", type=_list_of(int), default=RATES, help="bytes/s, with commas; 0 is no limit")
    parser.add_argument("--terminals", type=_list_of(str), default=("24bit", "vt220"), help=f"of {', '.join(KINDS)}")
    parser.add_argument("--scenes", type=_list_of(str), default=(MAIN.name, CAMERA.name))
    parser.add_argument("--peer", action="append", default=[], metavar="NAME=COMMAND")
    return parser.parse_args()


def _list_of(kind: Callable[[str], object]) -> Callable[[str], list[object]]:
    return lambda text: [kind(each) for each in text.split(",")]


# --- at rest


def _rest(sides: Sequence[Side], options: Namespace) -> None:
    print("\nat rest, bytes a second")
    _head(sides, "terminal", "shows", "Hz")
    for kind, scene, rate in RESTING:
        found = []
        for side in sides:
            with _console(side, kind, rate) as terminal:
                _open(terminal, scene)
                time.sleep(_SETTLES)
                found.append(_received(terminal))
        _row((kind, scene.name, f"{rate:g}"), [f"{each:,.0f}" for each in found], found)


def _received(terminal: SlowTerminal) -> float:
    """Return the bytes a second that a terminal receives."""
    received, began = terminal.received, time.monotonic()
    time.sleep(REST)
    return (terminal.received - received) / (time.monotonic() - began)


# --- keys


def _keys(sides: Sequence[Side], options: Namespace) -> None:
    print(f"\nfrom a key to the screen, s, {_PARTS} of {options.rounds}")
    _head(sides, "bytes/s", "terminal", "shows", "key")
    scenes = [each for each in (MAIN, CAMERA) if each.name in options.scenes]
    for rate, kind, scene in product(options.rates, options.terminals, scenes):
        took: list[_Took] = [{key: [] for key in KEYS} for _ in sides]
        for _ in range(options.rounds):
            for side, times in zip(sides, took, strict=True):
                with _console(side, kind) as terminal:
                    _press_all(terminal, scene, options.within, rate or None, times)
        _rows((f"{rate or 'any'}", kind, scene.name), took, options.within)


def _press_all(terminal: SlowTerminal, scene: Scene, within: float, rate: float | None, took: _Took) -> None:
    """Press each key once, and add the s until the screen showed it: `NEVER` for those that could not be pressed."""
    pressed = 0

    def press(key: str, first: Shows, whole: Shows, *, held: bool = False) -> None:
        nonlocal pressed
        time.sleep(_QUIET_AFTER if rate is None else _FULL_AFTER)
        took[KEYS[pressed]].append(terminal.key_to_screen(key, (first, whole), within, held=held))
        pressed += 1
        if not held:
            terminal.until(whole)

    _open(terminal, scene)
    terminal.rate = rate
    time.sleep(0.0 if rate is None else _SLOW_AFTER)
    try:
        *first, last = scene.help
        press("?", _has(_HELP, *first), _has(_HELP, *first, last, without=scene.last))
        press("q", _has(scene.first, without=_HELP), _has(scene.first, scene.last, without=_HELP))
        press(scene.drives, _has("Drive /cmd_vel", _DISARMED), _has("Drive /cmd_vel", _DISARMED, "esc leave"))
        press("A", _asks, lambda lines: _asks(lines) and _has("From now on", "disarms when")(lines))
        _agree(terminal)
        press("i", _has(_MOVES), _has(_MOVES), held=True)
    except NotShownError:  # such as a question whose Yes never counts
        for key in KEYS[pressed:]:
            took[key].append([NEVER, NEVER])


def _agree(terminal: SlowTerminal) -> None:
    """Answer the question with Yes, once its keys count."""
    for _ in range(_TRIES):
        terminal.type("y")
        if terminal.shows(_has(_ARMED), _AGAIN_AFTER):
            return
    terminal.until(_has(_ARMED), _AGAIN_AFTER)


# --- mosh


def _mosh(sides: Sequence[Side], options: Namespace) -> None:
    if not (shutil.which("mosh-server") and shutil.which("mosh-client")):
        print("\nmosh is not installed: apt install mosh")
        return
    print(f"\nover mosh: at rest, and from a key to the screen, s, {_PARTS} of {options.rounds}")
    _head(sides, "round trip", "lost", "shows", "key")
    for (round_trip, loss), scene in product(_PATHS, (MAIN, CAMERA)):
        if scene.name not in options.scenes:
            continue
        about = (f"{round_trip * 1e3:.0f} ms", f"{loss:.0%}", scene.name)
        rests: list[float] = []
        took: list[_Took] = [{key: [] for key in KEYS} for _ in sides]
        for side, times in zip(sides, took, strict=True):
            with _over_mosh(side, round_trip, loss) as (terminal, relay):
                _open(terminal, scene)
                time.sleep(_SETTLES)
                carried = relay.ways[1].carried
                _received(terminal)
                rests.append((relay.ways[1].carried - carried) / REST)
            for _ in range(options.rounds):
                with _over_mosh(side, round_trip, loss) as (terminal, relay):
                    _press_all(terminal, scene, options.within, None, times)
        _row((*about, "at rest, B/s"), [f"{each:,.0f}" for each in rests], rests)
        _rows(about, took, options.within)


@contextlib.contextmanager
def _over_mosh(side: Side, round_trip: float, loss: float) -> Iterator[tuple[SlowTerminal, Relay]]:
    """Run an attached console behind mosh, on a path with a delay and losses."""
    chance = random.Random(1)
    environ = {"LC_ALL": "C.UTF-8", "TERM": "xterm-256color", "MOSH_PREDICTION_DISPLAY": "never"}
    server = ["mosh-server", "new", "-i", "127.0.0.1", "-c", "256", "--", *side.command("attach", "desk")]
    started = subprocess.run(
        server, env=os.environ | side.set_up_console(4.0) | environ, capture_output=True, text=True, check=True
    )
    port, key = re.search(r"MOSH CONNECT (\d+) (\S+)", started.stdout).groups()  # type: ignore[union-attr]
    pid = int(re.search(r"pid = (\d+)", started.stdout + started.stderr)[1])  # type: ignore[index]
    try:
        with Relay(("127.0.0.1", int(port))) as relay:
            relay.delay = lambda: round_trip / 2
            relay.to_server = relay.to_client = lambda data: [data] if chance.random() >= loss else []
            client = ["mosh-client", "127.0.0.1", str(relay.port)]
            with SlowTerminal(client, KINDS["24bit"], environ | {"MOSH_KEY": key}) as terminal:
                yield terminal, relay
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)


# --- peers


def _peers(sides: Sequence[Side], options: Namespace) -> None:
    print("\nbeside other programs: bytes a second at rest, and bytes for a cursor key")
    print(f"{'program':<24} {'at rest, B/s':>14} {'a key, B':>10}")
    for side, rate in product(sides, (4.0, 0.5)):
        with _console(side, "24bit", rate) as terminal:
            _open(terminal, MAIN)
            _peer(f"{side.name}, {rate:g} Hz", terminal)
    programs = {"htop": "htop"} if shutil.which("htop") else {}
    programs |= dict(each.partition("=")[::2] for each in options.peer)
    for name, command in programs.items():
        with SlowTerminal(shlex.split(command), KINDS["24bit"], {"ROS_DOMAIN_ID": str(options.domain + 1)}) as terminal:
            terminal.until(lambda lines: sum(bool(line.strip()) for line in lines) > 3)
            _peer(name, terminal)


def _peer(name: str, terminal: SlowTerminal) -> None:
    time.sleep(_SETTLES)
    rest, by_key = _received(terminal), []
    for _ in range(_CURSOR_KEYS):
        received, began = terminal.received, time.monotonic()
        terminal.type(terminal.down)
        while terminal.received == received and time.monotonic() - began < 1.0:
            time.sleep(0.01)
        time.sleep(_KEY_SHOWN)
        by_key.append(terminal.received - received - rest * (time.monotonic() - began))
        time.sleep(1.0)
    print(f"{name:<24} {rest:>14,.0f} {max(0.0, statistics.mean(by_key)):>10,.0f}", flush=True)


PARTS = {"rest": _rest, "keys": _keys, "mosh": _mosh, "peers": _peers}


# --- consoles and tables


def _console(side: Side, kind: str, rate: float = 4.0) -> SlowTerminal:
    return SlowTerminal(side.command("attach", "desk"), KINDS[kind], side.set_up_console(rate))


def _open(terminal: SlowTerminal, scene: Scene) -> None:
    terminal.until(_has("DISARMED", "/cmd_vel"))
    for _ in range(_TRIES):
        terminal.type("g")  # the first row, which has the worst state
        if terminal.shows(_is_selected, _AGAIN_AFTER):
            break
    for keys, text in scene.opens:
        terminal.type(keys)
        terminal.until(_has(text))


def _is_selected(lines: Sequence[str]) -> bool:
    """Return whether the cursor, a sign in the first column, is at the topic that is driven."""
    return any(line[0] != " " and "DISARMED" in line and "/cmd_vel" in line for line in lines)


def _has(*texts: str, without: str = "\0") -> Shows:
    """Return whether lines contain all of some texts, and not another one."""

    def shows(lines: Sequence[str]) -> bool:
        shown = "\n".join(lines)
        return all(each in shown for each in texts) and without not in shown

    return shows


def _asks(lines: Sequence[str]) -> bool:
    """Return whether the question to arm stands there, with both answers."""
    return _has(_QUESTION)(lines) and any(map(_ANSWERS.search, lines))


def _rows(about: tuple[str, ...], took: Sequence[Mapping[str, Sequence[Sequence[float]]]], within: float) -> None:
    for key in KEYS:
        cells, middles = [], []
        for side in took:
            parts = [*zip(*side[key], strict=True)]
            middles.append(statistics.median(parts[0]))
            cells.append(
                "  ".join(f"{_time(statistics.median(each), within)} {_time(max(each), within)}" for each in parts)
            )
        _row((*about, key), cells, middles)


def _time(seconds: float, within: float) -> str:
    return f">{within:.0f}" if seconds == NEVER else f"{seconds:.2f}"


def _head(sides: Sequence[Side], *about: str) -> None:
    _row(about, [each.name for each in sides], ())


def _row(about: Sequence[str], cells: Sequence[str], figures: Sequence[float]) -> None:
    names = "".join(f"{each:<{22 if number else 12}}" for number, each in enumerate(about))
    ratio = ""
    if len(figures) > 1 and figures[0]:
        ratio = f"{'never' if figures[1] == NEVER else f'{figures[1] / figures[0]:.2g}×':>10}"
    print(names + "".join(f"{each:>26}" for each in cells) + ratio, flush=True)


if __name__ == "__main__":
    main()
