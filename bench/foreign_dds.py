"""Puts programs that nobody here wrote at either end of a bridge: ``python -m bench.foreign_dds --json FILE`` (root).

``[--parts rustdds,cyclonedds] [--cases reliable,large]``: the others stay in the file as they are. A part speaks to a
stock node and hears it, in each case three times: in one domain, from the robot's end of a bridge, and from the desk's.
What a bridged run lacks of the first one is a fault of the bridge, or a line of docs/foreign.md, which `make plots`
writes from the file.

All of it runs in a network and a shared memory of its own, as some of these programs use each interface that is up.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import importlib.util
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self

from bench import bed  # noqa: F401 -- children find `bench` by it
from bench.dds_ends import PROGRAMS

from rsb_bridge.feature_api import attach
from rsb_extras.bench.loopback import write_sessions
from rsb_extras.demo.processes import Process, listening

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

FILE = Path(__file__).parents[1] / "docs/figures/foreign_dds.json"
NEAR, FAR = 1, 2  # domains of the namespace, in which nobody else is
ENDS = ("direct", "robot", "desk")
"""Where a part is: in one domain with the stock node, or at an end of a bridge with the node at the other."""
_INSIDE = "RSB_BENCH_INSIDE"
_ALONE = (
    "mount -t sysfs none /sys; mount -t tmpfs none /dev/shm; "
    'ip link set lo up multicast on; ip route add 224.0.0.0/4 dev lo; exec "$@"'
)
_ENVIRON = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}  # the default, which finds programs of other implementations
_OPENS_WITHIN, _AGAIN = 20.0, 0.25  # s until a first message is heard, and between two attempts
_STATE_WITHIN = 1.0  # s: a bridge renews its state each 0.25 s, and its peer's
_SETTLES = 4.0  # s without a message after which no more are awaited


class Part(NamedTuple):
    """A program.

    Attributes:
        title: its name and its version.
        program: the argument of `bench.dds_ends`.
        means: the cases that not every program has the means for, ``CASE`` or ``CASE WAY``.
        environ: changes to the environment of all in its domain.
    """

    title: str
    program: str
    means: Sequence[str] = ()
    environ: Mapping[str, str] = {}


_SERVER = 11811
_OF_NODES = ("enhanced", "parameters", "clock")
_WITH_KEYS = ("keyed", "keyed_latched")
"""Cases whose type an older distribution does not have."""
_OF_PARTICIPANTS = ("keyed hears", "keyed_latched hears", "own_key")
"""They publish no type with a key to a node that has it: see docs/foreign.md, Types with a key."""
PARTS = {
    "stock": Part("A stock node", "stock", _OF_NODES),
    "kilted": Part("A node of Kilted, rclpy 9.1.2, Fast DDS 3.2.3", "other", (*_OF_NODES, *_WITH_KEYS)),
    "discovery-server": Part(
        "Stock nodes with a discovery server of Fast DDS",
        "stock",
        _OF_NODES,
        {"ROS_DISCOVERY_SERVER": f"127.0.0.1:{_SERVER}"},
    ),
    "cyclonedds": Part("Cyclone DDS, cyclonedds 11.0.1", "cyclone", _OF_PARTICIPANTS),
    "rustdds": Part("RustDDS 0.15.1", "with_rustdds", _OF_PARTICIPANTS),
    "ros2-client": Part(
        "ros2-client 0.12.1, RustDDS 0.15.1",
        "with_ros2_client",
        ("enhanced", "basic", "cyclone", "parameters", "clock speaks"),
    ),
    "rosbridge": Part(
        "A WebSocket client of rosbridge-server-rs 0.1.6", "rosbridge", ("enhanced", "parameters hears", "clock speaks")
    ),
    "dust-dds": Part("Dust DDS 0.16.0", "with_dust_dds", _OF_PARTICIPANTS),
}


class Run(NamedTuple):
    """Messages that were heard of those that a stock node would have heard."""

    heard: int
    of: int
    note: str = ""


class Program:
    """A process of `bench.dds_ends`, and what it has said."""

    def __init__(self, part: Part, domain: int, environ: Mapping[str, str], *, is_foreign: bool = False) -> None:
        self.is_foreign = is_foreign
        self._part, self._domain, self._environ = part, domain, environ
        self._said = threading.Condition()
        self._lines: list[list[str]] = []
        self._start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stop()

    @property
    def node(self) -> str:
        return "/foreign" if self.is_foreign else "/stock"

    def tell(self, *words: object) -> None:
        self._process.tell(" ".join(map(str, words)))

    def kill(self) -> None:
        """End it without a word, and start it again."""
        self._process.signal(signal.SIGKILL)
        self._process.stop()
        self._lines.clear()
        self._start()

    def heard(self, topic: str, mark: str = "") -> list[str]:
        """Return the marks of messages that begin like `mark`, in the order in which they came."""
        with self._said:
            return [words[2] for words in self._lines if words[:2] == ["heard", topic] and words[2].startswith(mark)]

    def answered(self, name: str) -> int:
        """Return the number of answers that a service has given it."""
        with self._said:
            return sum(words[:2] == ["answered", name] for words in self._lines)

    def events(self, topic: str, *named: str) -> list[str]:
        """Return the events on a topic, of these if any are named."""
        with self._said:
            said = [words[2:] for words in self._lines if words[:2] == ["event", topic]]
        return [" ".join(words) for words in said if not named or words[0] in named]

    def wait(self, is_true: Callable[[], object], seconds: float) -> bool:
        """Wait until something is true of what it has said, and return whether it is."""
        with self._said:
            return bool(self._said.wait_for(is_true, seconds))

    def _start(self) -> None:
        command = ("-m", "bench.dds_ends", self._part.program, str(self._domain), self.node.strip("/"))
        self._process = Process(*command, environ={**_ENVIRON, **self._environ})
        threading.Thread(target=self._read, args=(self._process,), daemon=True).start()
        if not self.wait(lambda: self._lines[-1:] == [["ready"]], 60.0):
            raise SystemExit(f"{self._part.title} does not start")

    def _read(self, process: Process) -> None:
        with contextlib.suppress(ValueError):  # it has been closed
            while words := process.line().split():
                with self._said:
                    self._lines.append(words)
                    self._said.notify_all()


# Cases ##############################################################################################################


def _series(
    policies: str, count: int, size: int, interval: float, of_part: str = ""
) -> Callable[[Program, Program, str], Run]:
    def run(speaker: Program, hearer: Program, topic: str) -> Run:
        for program, order in ((hearer, "read"), (speaker, "write")):
            program.tell(order, topic, policies, of_part if program.is_foreign else "")
        if not _opened(speaker, hearer, topic):
            return Run(0, count, _why(hearer, topic))
        for number in range(count):
            speaker.tell("publish", topic, f"m{number}", size)
            hearer.wait(lambda: False, interval)
        return Run(_settled(hearer, topic, count), count)

    return run


def _latched(policies: str, marks: Sequence[str], newest: Sequence[str]) -> Callable[[Program, Program, str], Run]:
    """Publish, and listen late: the newest are to come in their order."""

    def run(speaker: Program, hearer: Program, topic: str) -> Run:
        speaker.tell("write", topic, "latched", policies)
        for mark in marks:
            speaker.tell("publish", topic, mark, 10)
        hearer.wait(lambda: False, 5.0)  # so that a bridge has them, and the one that hears is late
        hearer.tell("read", topic, "latched", policies)
        hearer.wait(lambda: newest[-1] in hearer.heard(topic), _OPENS_WITHIN)
        _settled(hearer, topic, 1000)
        heard = hearer.heard(topic, "m")
        in_place = sum(mark == right for mark, right in zip(heard[-len(newest) :], newest, strict=False))
        return Run(in_place, len(newest), "" if heard == newest else " ".join(heard))

    return run


def _silence(asked: str, offered: str, event: str) -> Callable[[Program, Program, str], Run]:
    """Publish with a policy to a reader that has one, too, and stop: an event has to tell of it."""

    def measure(speaker: Program, hearer: Program, topic: str) -> Run:
        hearer.tell("read", topic, asked)
        speaker.tell("write", topic, offered)
        if not _opened(speaker, hearer, topic):
            return Run(0, 1, _why(hearer, topic))
        return _told(hearer, topic, event)

    return measure


def _told(hearer: Program, topic: str, event: str) -> Run:
    told = hearer.wait(lambda: hearer.events(topic, event), 10.0)
    return Run(int(told), 1, "" if told else "its messages came, and nothing said that they ended")


def _lifespan(speaker: Program, hearer: Program, topic: str) -> Run:
    """Latch messages for 2 s, and listen after 6: to hear none is right."""
    speaker.tell("write", topic, "latched depth=5 lifespan=2")
    for number in range(5):
        speaker.tell("publish", topic, f"m{number}", 10)
    hearer.wait(lambda: False, 6.0)
    hearer.tell("read", topic, "latched depth=5")
    hearer.wait(lambda: hearer.heard(topic, "m"), 4.0)
    late = len(hearer.heard(topic, "m"))
    if not _opened(speaker, hearer, topic):
        return Run(0, 5, _why(hearer, topic))
    return Run(5 - late, 5, f"{late} came after their lifespan" if late else "")


def _killed(speaker: Program, hearer: Program, topic: str) -> Run:
    """Kill the part, and start it again: the messages of its second life count."""
    hearer.tell("read", topic)
    speaker.tell("write", topic)
    if not _opened(speaker, hearer, topic):
        return Run(0, 10, _why(hearer, topic))
    foreign = hearer if hearer.is_foreign else speaker
    foreign.kill()
    foreign.tell("read" if foreign is hearer else "write", topic)
    began, opened = time.monotonic(), _opened(speaker, hearer, topic, "second")
    took = time.monotonic() - began
    for number in range(10):
        speaker.tell("publish", topic, f"m{number}", 10)
        hearer.wait(lambda: False, 0.05)
    return Run(_settled(hearer, topic, 10) if opened else 0, 10, f"back after {took:.0f} s" if opened else "")


def _calls(mapping: str) -> Callable[[Program, Program, str], Run]:
    def run(server: Program, caller: Program, service: str) -> Run:
        server.tell("serve", service, mapping)
        return _answers(caller, service, "call", service, mapping)

    return run


def _parameters(server: Program, caller: Program, _: str) -> Run:
    return _answers(caller, server.node, "set", server.node)


def _answers(caller: Program, service: str, *order: object) -> Run:
    """Call until a first answer comes, and ten times more, each after the answer or 2 s."""
    deadline = time.monotonic() + _OPENS_WITHIN
    while time.monotonic() < deadline and not caller.answered(service):
        caller.tell(*order)
        caller.wait(lambda: caller.answered(service), 1.0)
    caller.wait(lambda: False, 1.0)  # for late answers
    if not (first := caller.answered(service)):
        return Run(0, 10)
    for number in range(10):
        caller.tell(*order)
        caller.wait(lambda number=number: caller.answered(service) > first + number, 2.0)  # type: ignore[misc]
    return Run(caller.answered(service) - first, 10)


def _clock(speaker: Program, hearer: Program, _: str) -> Run:
    hearer.tell("watch")
    for second in range(round(_OPENS_WITHIN / _AGAIN)):
        speaker.tell("tick", second)
        if hearer.wait(lambda: len(hearer.heard("/clock")) >= 10, _AGAIN):
            break
    return Run(min(10, len(hearer.heard("/clock"))), 10)


def _opened(speaker: Program, hearer: Program, topic: str, mark: str = "first") -> bool:
    """Publish until the first message is heard."""
    deadline = time.monotonic() + _OPENS_WITHIN
    while time.monotonic() < deadline:
        speaker.tell("publish", topic, mark, 1)
        if hearer.wait(lambda: hearer.heard(topic, mark), _AGAIN):
            return True
    return False


def _settled(hearer: Program, topic: str, count: int) -> int:
    """Wait until so many messages are heard, or no more come; return the number of different ones."""
    before = -1
    while (now := len(set(hearer.heard(topic, "m")))) < count and now > before:
        before = now
        hearer.wait(lambda now=now: len(set(hearer.heard(topic, "m"))) > now, _SETTLES)  # type: ignore[misc]
    return now


def _why(hearer: Program, topic: str) -> str:
    return (hearer.events(topic) or [""])[-1]


CASES: Mapping[str, Callable[[Program, Program, str], Run]] = {
    "best_effort": _series("best_effort", 20, 100, 0.05),
    "reliable": _series("", 20, 100, 0.05),
    "latched": _latched("depth=5", [f"m{number}" for number in range(7)], [f"m{number}" for number in range(2, 7)]),
    "large": _series("", 10, 1_000_000, 0.5),
    "large_best_effort": _series("best_effort", 10, 1_000_000, 0.5),
    "deadline": _silence("deadline=1", "deadline=0.5", "deadline"),
    "liveliness": _silence("lease=2", "lease=1", "not_alive"),  # asserted by messages alone
    "lifespan": _lifespan,
    "enhanced": _calls("enhanced"),
    "basic": _calls("basic"),
    "cyclone": _calls("cyclone"),
    "parameters": _parameters,
    "clock": _clock,
    "killed": _killed,
    "keyed": _series("keyed", 20, 100, 0.05),
    "keyed_latched": _latched("keyed depth=1", ["m0", "m1", "m10", "m11"], ["m10", "m11"]),  # of each key the last
    "own_key": _series("", 20, 100, 0.05, of_part="key"),
}
_NEED_MEANS = {"enhanced", "basic", "cyclone", "parameters", "clock", *_WITH_KEYS, "own_key"}
_KINDS = dict.fromkeys(("enhanced", "basic", "cyclone"), "service") | {"parameters": "node"}
"""Of the cases that are no topics."""
_LISTS = {"topic": "topics", "service": "services", "node": "parameters"}
_NAMES = {("clock", "speaks"): "/clock", ("parameters", "speaks"): "/foreign", ("parameters", "hears"): "/stock"}
"""Of the cases whose name matters."""

# The bed ############################################################################################################


def ways(part: Part, cases: Iterable[str]) -> list[tuple[str, str]]:
    """Return the cases that a part has the means for, and the ways: whether it ``speaks`` (answers) or ``hears``."""
    found = []
    for case, way in itertools.product(cases, ("speaks", "hears")):
        has_means = case not in _NEED_MEANS or {case, f"{case} {way}"} & set(part.means)
        if has_means and (case, way) != ("clock", "hears"):
            found.append((case, way))
    return found


def measured(part: Part, asked: Sequence[tuple[str, str]], end: str) -> Iterator[tuple[str, str, dict[str, object]]]:
    """Yield each case, the way, and the result."""
    parts_domain = FAR if end == "desk" else NEAR
    nodes_domain = {"direct": NEAR, "robot": FAR, "desk": NEAR}[end]
    environs: dict[int, Mapping[str, str]] = {parts_domain: part.environ}
    with contextlib.ExitStack() as started:
        folder = Path(started.enter_context(tempfile.TemporaryDirectory(prefix="rsb-bench-")))
        if part.environ:
            started.enter_context(Process("-m", "bench.dds_ends", "server", str(_SERVER), "-"))
        foreign = started.enter_context(Program(part, parts_domain, part.environ, is_foreign=True))
        stock = started.enter_context(Program(PARTS["stock"], nodes_domain, environs.get(nodes_domain, {})))
        sockets = started.enter_context(_bridge(folder, asked, end, environs)) if end != "direct" else ()
        for case, way in asked:
            speaker, hearer = (foreign, stock) if way == "speaks" else (stock, foreign)
            name = _name(case, way)
            run = CASES[case](speaker, hearer, name)
            yield case, way, run._asdict() | {"screens": [_verdict(socket, name) for socket in sockets]}


def _name(case: str, way: str) -> str:
    return _NAMES.get((case, way), f"/{case}_{way}")


@contextlib.contextmanager
def _bridge(
    folder: Path, asked: Sequence[tuple[str, str]], end: str, environs: Mapping[int, Mapping[str, str]]
) -> Iterator[tuple[Path, Path]]:
    """Join the two domains; yield the robot's and the desk's control socket."""
    lists: dict[str, list[str]] = {}
    for case, way in asked:
        lists.setdefault(_LISTS[_KINDS.get(case, "topic")], []).append(_entry(case, way, end))
    key, *lines = (line for name, entries in lists.items() for line in (f"{name}:", *entries))
    port = write_sessions(folder, NEAR, FAR, lines, key=key.removesuffix(":"))
    with _side(folder / "server.yaml", environs.get(FAR, {})) as server:
        listening(server, port)
        with _side(folder / "client.yaml", environs.get(NEAR, {})):
            yield folder / "client.sock", folder / "server.sock"


def _entry(case: str, way: str, end: str) -> str:
    """Return the line of a case in the robot's session."""
    at_robot = (way == "speaks") == (end == "robot")  # the program that publishes or answers
    kind = _KINDS.get(case, "topic")
    key, ends = ("direction", ("transmit", "receive")) if kind == "topic" else ("provider", ("client", "server"))
    return f"  - {{{kind}: {_name(case, way)}, {key}: {ends[0] if at_robot else ends[1]}}}"


def _side(session: Path, more: Mapping[str, str]) -> Process:
    """Start a side that finds other implementations, as it does by default (`loopback.headless` stays on loopback)."""
    folder, control = session.parent, str(session.with_suffix(".sock"))
    environ = {**_ENVIRON, **more, "XDG_RUNTIME_DIR": str(folder), "XDG_STATE_HOME": str(folder)}
    command = ("-m", "rsb_console", "run", "--no-ui", "--control", control, str(session))
    return Process(*command, log=folder / f"{session.stem}.log", environ=environ)


def _verdict(socket: Path, topic: str) -> str:
    """Return what a side says of a topic, once its state is up to date."""
    time.sleep(_STATE_WITHIN)
    with attach(socket, read_only=True) as engine:
        route = next((each for each in engine.snapshot().routes if each.topic == topic), None)
    return f"{route.state} {route.cause} {route.reason}".strip() if route else "no route"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.foreign_dds")
    parser.add_argument("--json", type=Path, default=FILE)
    parser.add_argument(
        "--parts", default=",".join(each for each in PARTS if each != "stock"), help=f"of {', '.join(PARTS)}"
    )
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--ends", default=",".join(ENDS))
    options = parser.parse_args()
    if unknown := {*options.parts.split(",")} - {*PARTS}:
        parser.error(f"no part is called {', '.join(unknown)}")
    if _INSIDE not in os.environ:
        command = [sys.executable, "-m", "bench.foreign_dds", *sys.argv[1:]]
        inside = ["unshare", "--map-root-user", "--net", "--mount", "sh", "-ec", _ALONE, "sh", *command]
        raise SystemExit(subprocess.run(inside, env=os.environ | {_INSIDE: "1"}, check=False).returncode)
    cases = options.cases.split(",")
    if not _has_keyed_type() and (left_out := [case for case in cases if case in _WITH_KEYS]):
        cases = [case for case in cases if case not in left_out]
        print(f"{', '.join(left_out)}: no type with a key is installed: run this with Kilted's Python", flush=True)
    for name in options.parts.split(","):
        part = PARTS[name]
        if not (asked := ways(part, cases)):
            continue
        if missing := _missing(part):
            print(f"{part.title}: {missing}", flush=True)
            continue
        for end in options.ends.split(","):
            for case, way, result in measured(part, asked, end):
                print(f"{name:<12} {end:<7} {case:<18} {way:<7}", *result.values(), flush=True)
                _keep(options.json, part, name, (case, way, end), result)


def _has_keyed_type() -> bool:
    """Whether test_msgs has KeyedString, which is looked for without loading ROS's libraries."""
    package = importlib.util.find_spec("test_msgs")
    return package is not None and any(
        Path(folder, "msg/_keyed_string.py").exists() for folder in package.submodule_search_locations or ()
    )


def _missing(part: Part) -> str:
    """Return why a part cannot be run, or an empty string."""
    if part.program.startswith("with_") and not (PROGRAMS / part.program).exists():
        return "it is not built: run `make peers` (cargo)"
    if part.program == "cyclone" and importlib.util.find_spec("cyclonedds") is None:
        return "cyclonedds is not installed: pip install cyclonedds"
    if part.program == "rosbridge" and not all(map(importlib.util.find_spec, ("rosbridge_server_rs", "websockets"))):
        return "it is not installed: pip install rosbridge-server-rs websockets"
    if part.program == "rosbridge" and not sysconfig.get_config_var("Py_ENABLE_SHARED"):
        return "ROS's wheels take names of Python's, and this Python has no shared library"
    if part.program == "other" and "OTHER_PYTHON" not in os.environ:
        return "OTHER_PYTHON does not name a Python with this distribution"
    if part.environ and shutil.which("fast-discovery-server") is None:
        return "fast-discovery-server is not installed"
    return ""


def _keep(file: Path, part: Part, name: str, place: tuple[str, str, str], result: Mapping[str, object]) -> None:
    found = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    its = found.setdefault(name, {"title": part.title, "cases": {}})
    case, way, end = place
    seen = {"seen": datetime.datetime.now(datetime.UTC).date().isoformat(), "beside": _beside()}
    its["cases"].setdefault(case, {}).setdefault(way, {})[end] = {**result, **seen}
    file.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _beside() -> str:
    """Return the versions of the stock nodes and their DDS, of a distribution's own ROS its name."""
    try:
        dds = "ros-fastdds" if _has_keyed_type() else "ros-fastrtps"
        return f"rclpy {metadata.version('ros-rclpy')}, Fast DDS {metadata.version(dds)}"
    except metadata.PackageNotFoundError:
        return f"ROS 2 {os.environ.get('ROS_DISTRO', '')}"


if __name__ == "__main__":
    main()
