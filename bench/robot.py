"""Measures what a robot's topics have of a thin link: ``python -m bench.robot`` prints a table for each link.

A robot with nav2 and an operator's PC have network namespaces of their own. Between them is a Wi-Fi of 20
Mbit/s that delays by 20 ± 15 ms, loses 2 % of the packets and all for 3 s of every 30 s, or a tunnel of 5 kB/s that
keeps 4.4 MB (`wifi.c`). Plain nodes publish on the robot and listen on the PC, and our bridge is between them. In the
column ``dds`` nothing is, and the nodes find each other by address: what a user would have without a bridge. In the
column ``bare`` are two processes that do no more than pass each topic on over a TCP connection. A cell has
the latencies' p50 and p99 in ms and the part of the messages that arrived. Messages of a gap, and of the 3 s after it,
count as arrived or lost only. Of calls, it is the time until the answer and the part that was answered.

``--congestion cubic,bbr`` compares what the kernel makes of TCP's losses.

It needs root, /dev/net/tun, a C compiler and iproute2, and takes the seconds of a run and some 15 s for each column.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bench.bed import FAR, NEAR, ROOT
from bench.robot_ends import GOAL, NODE, PARAMETERS, RESULT
from tests.network.hosts import Host, NoHostError

from rsb_bridge.ros.memory import PROFILE_VARIABLES

if TYPE_CHECKING:
    from collections.abc import Sequence

_ROBOT, _PC = "10.98.0.1", "10.98.0.2"
_PORT = 49152
_CONTROL = Path("/proc/sys/net/ipv4")
_DEFAULT = _CONTROL / "tcp_congestion_control"
_AVAILABLE = "of " + (_CONTROL / "tcp_available_congestion_control").read_text(encoding="ascii").strip()
_CPUCLOCK_SCHED = 2  # clock_getcpuclockid(3), as Linux makes the id of a process's clock
_AFTER_GAP = 3.0
_DRAINS = 5.0
"""s in which the last messages arrive after the robot has stopped."""
_MATCHES_WITHIN = 30.0
_PROFILE = ROOT / "configs" / "fastdds-large-messages.xml"
"""Without it, DDS hands on hardly one image of 6 MB a minute in full, and small topics late, on the same machine."""
_NO_BRIDGE = ("bare", "dds")
_TYPE = "std_msgs/msg/String"
_LOST = re.compile("link with the server at .* lost: ")
_BRIDGE = """
import sys
from rsb_bridge.transport import tcp
tcp.BBR = sys.argv.pop(1)  # what a column asks for, instead of the one that the bridge prefers
from rsb_console.cli import main
sys.exit(main(sys.argv[1:]))
"""


class Spoken(NamedTuple):
    """A topic of the robot.

    Attributes:
        transport: that it always uses, or an empty string for the column's.
        robot: whose bridge sends it. All robots are at one end of the link.
        to_robot: whether the PC publishes it, for the robot.
    """

    name: str
    rate: float
    size: int
    priority: str = "normal"
    reliability: str = "reliable"
    transport: str = ""
    robot: str = "robot"
    to_robot: bool = False

    @property
    def row(self) -> str:
        """The figures' name: topics that differ in their number only are one."""
        return self.name.rstrip("0123456789")

    @property
    def is_large(self) -> bool:
        """Whether it has a process of its own, since publishing it takes milliseconds."""
        return self.size > 50_000

    def __str__(self) -> str:
        return f"{self.name}:{self.rate}:{self.size}:{self.reliability}"


class Called(NamedTuple):
    """Something of the robot that the PC calls.

    Attributes:
        size: bytes of an answer of a service.
        kind: ``service``, ``action``, or ``parameters`` of the node.
    """

    name: str
    rate: float
    size: int
    kind: str = "service"

    @property
    def rows(self) -> Sequence[str]:
        """The measured topics or calls."""
        return (GOAL + self.name, RESULT + self.name) if self.kind == "action" else (self.name,)

    @property
    def entry(self) -> str:
        """Its entry in a session."""
        return f"node: /{NODE}" if self.kind == "parameters" else f"{self.kind}: {self.name}"

    def __str__(self) -> str:
        return f"{self.name}:{self.rate}:{self.size}:{self.kind}"


class Column(NamedTuple):
    """A way for the messages to cross, with the kernel's congestion control of TCP."""

    transport: str
    priorities: str
    congestion: str

    def __str__(self) -> str:
        priorities = f"{self.priorities} priorities" if self.priorities else ""
        return ", ".join(filter(None, (self.transport, priorities, self.congestion)))


class Link(NamedTuple):
    """A link, with the arguments of `wifi.c`, and the topics and calls on it."""

    figures: str
    topics: tuple[Spoken, ...]
    calls: tuple[Called, ...] = ()

    @property
    def robots(self) -> Sequence[str]:
        """The owners of the bridges that it carries."""
        return list(dict.fromkeys(each.robot for each in self.topics))

    @property
    def rows(self) -> dict[str, str]:
        """The figures in words, by their names."""
        topics = {each.row: f"{each.row} {each.rate:g} Hz × {each.size:,}" for each in self.topics}
        return topics | {row: f"{row} {each.rate:g} Hz × {each.size:,}" for each in self.calls for row in each.rows}


LINKS = {
    "wifi": Link(
        "20 15 2 20000000 400000 30 3",
        (
            Spoken("/odom", 50, 730, "high"),
            Spoken("/tf", 50, 400, "high"),
            Spoken("/joint_states", 100, 470),
            Spoken("/imu", 100, 330, reliability="best_effort"),
            Spoken("/scan", 10, 4000, reliability="best_effort"),
            Spoken("/pose", 5, 360),
            Spoken("/path", 1, 20_000),
            Spoken("/local_costmap", 2, 3_700),
            Spoken("/costmap", 1, 40_000),
            Spoken("/battery", 0.5, 200),
            Spoken("/health", 1, 4_000),
            Spoken("/camera", 30, 60_000, "low", "best_effort"),
            Spoken("/raw", 10, 6_220_800, "low", "best_effort"),
        ),
        (
            Called("/status", 2, 60),
            Called("/plan", 0.5, 20_000),
            Called("/clear", 0.2, 0),
            Called("/navigate", 0.2, 0, "action"),
            Called(PARAMETERS, 0.5, 0, "parameters"),
        ),
    ),
    "tunnel": Link(
        "5 0 0 40000 4400000 0 0",
        (
            Spoken("/high", 10, 100, "high"),
            Spoken("/normal", 10, 500),
            Spoken("/low", 10, 500, "low", "best_effort"),
        ),
    ),
    "mixed": Link(
        "5 0 0 40000 10000 0 0",
        (
            Spoken("/odom", 20, 700, transport="tcp"),
            Spoken("/scan", 15, 1_000, reliability="best_effort", transport="udp"),
            Spoken("/joy", 10, 50, transport="tcp"),
        ),
    ),
    "high-udp": Link(
        "5 0 0 40000 10000 0 0",
        (
            Spoken("/odom", 20, 700, transport="tcp"),
            Spoken("/scan", 15, 1_000, "high", "best_effort", transport="udp"),
        ),
    ),
    "whole": Link("5 0 0 40000 10000 0 0", (Spoken("/cloud", 1, 20_000, "normal", "best_effort", transport="udp"),)),
    "lossy": Link(
        "20 0 30 20000000 400000 0 0",
        (
            Spoken("/scan", 50, 1_000, reliability="best_effort", transport="udp"),
            Spoken("/slow", 2, 200, reliability="best_effort", transport="udp"),
            Spoken("/odom", 10, 100, transport="tcp"),
        ),
    ),
    "alone": Link("20 0 2 20000000 400000 0 0", (Spoken("/joint_states", 100, 470),)),
    "beside": Link(
        "20 0 2 20000000 400000 0 0",
        (Spoken("/joint_states", 100, 470), Spoken("/camera", 20, 60_000, reliability="best_effort")),
    ),
    "two-robots": Link(
        "20 15 2 20000000 400000 0 0",
        tuple(
            Spoken(f"{name}{topic}", rate, size, priority, reliability, robot=robot)
            for robot, name in (("robot", ""), ("second", "/second"))
            for topic, rate, size, priority, reliability in (
                ("/odom", 50, 730, "high", "reliable"),
                ("/joint_states", 100, 470, "normal", "reliable"),
                ("/camera", 30, 60_000, "low", "best_effort"),
            )
        ),
    ),
    "both-ways": Link(
        "20 15 2 20000000 400000 0 0",
        (
            Spoken("/odom", 50, 730, "high"),
            Spoken("/joint_states", 100, 470),
            Spoken("/cmd_vel", 20, 60, "high", to_robot=True),
            Spoken("/map", 40, 60_000, "low", "best_effort", to_robot=True),
        ),
    ),
    "many": Link("20 0 0 20000000 400000 0 0", tuple(Spoken(f"/topic{number}", 1, 300) for number in range(500))),
}

_WIFI = LINKS["wifi"]
# An operator who wants whole images sooner than pictures of the camera.
LINKS["raw-first"] = _WIFI._replace(
    topics=tuple(each._replace(priority="high") if each.name == "/raw" else each for each in _WIFI.topics)
)


@dataclass
class Run:
    """The messages of one run.

    Attributes:
        made: when (ns) each message was published, or call made, by name.
        heard: when (ns) each that arrived, or was answered, was made and heard.
        gaps: when (s) gaps began and ended.
        bytes: that crossed to the PC.
        cpu: s of both sides' processors.
        descriptors: file descriptors of the side that had more.
        lost: how often the link was lost.
    """

    made: dict[str, list[int]]
    heard: dict[str, list[list[int]]]
    gaps: list[tuple[float, float]]
    bytes: int
    cpu: float
    descriptors: int
    lost: int = 0

    def cell(self, topic: str) -> tuple[float, float, float]:
        """Return p50 and p99 (ms) and the part that arrived."""
        delays = sorted(
            (heard - made) / 1e6
            for made, heard in self.heard.get(topic, ())
            # A message that was in transit when a gap began belongs to the gap.
            if not any(begins - 0.5 < made / 1e9 < ends + _AFTER_GAP for begins, ends in self.gaps)
        ) or [float("nan")]
        part = len({made for made, _ in self.heard.get(topic, ())}) / max(1, len(self.made.get(topic, ())))
        return delays[len(delays) // 2], delays[len(delays) * 99 // 100], part


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--links", default="wifi,tunnel", help=", ".join(LINKS))
    parser.add_argument("--transports", default="tcp,udp,zenoh,bare,dds")
    parser.add_argument("--congestion", default=_DEFAULT.read_text(encoding="ascii").strip(), help=_AVAILABLE)
    parser.add_argument("--priorities", default="with,without")
    parser.add_argument("--seconds", type=float, default=68.0)
    parser.add_argument("--rounds", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="rsb-robot-") as name:
        folder = Path(name)
        program = _built(folder)
        for link in options.links.split(","):
            columns = [
                Column(transport, priorities, congestion)
                for transport in options.transports.split(",")
                for priorities in (options.priorities.split(",") if transport not in _NO_BRIDGE else [""])
                for congestion in (options.congestion.split(",") if transport not in {"dds", "udp"} else [""])
            ]
            runs: dict[Column, list[Run]] = {column: [] for column in columns}
            for _ in range(options.rounds):
                for column in columns:
                    try:
                        run = _run(folder, program, LINKS[link], column, options.seconds)
                    except NoHostError as error:
                        raise SystemExit(f"no namespaces: {error}; run this as root") from None
                    runs[column].append(run)
            _print(link, runs, options.seconds)


def _built(folder: Path) -> Path:
    if os.geteuid() or not Path("/dev/net/tun").exists():
        raise SystemExit("bench.robot needs root and /dev/net/tun: it puts a link between two network namespaces")
    if (compiler := shutil.which("cc")) is None:
        raise SystemExit("bench.robot builds a program in C: install a compiler (apt install gcc)")
    program = folder / "wifi"
    subprocess.run((compiler, "-O2", "-o", program, ROOT / "bench" / "wifi.c"), check=True)
    return program


class _Child:
    """A Python program on a host, which answers lines with lines of JSON."""

    def __init__(self, host: Host, *command: str, peer: str = "", log: Path | None = None) -> None:
        output = log.open("w") if log else subprocess.PIPE
        # Hosts have a network of their own, so that what DDS sends to a peer, it sends there only.
        finds = {"ROS_STATIC_PEERS": peer, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"} if peer else {}
        variables = {**os.environ, **dict.fromkeys(PROFILE_VARIABLES, str(_PROFILE)), **finds}
        self.process = host.start(
            sys.executable, *command, stdin=subprocess.PIPE, stdout=output, stderr=output, env=variables
        )

    def tell(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def answer(self) -> dict[str, list[int]]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            assert self.process.stderr is not None
            raise SystemExit(self.process.stderr.read())
        answer: dict[str, list[int]] = json.loads(line)
        return answer

    def cpu(self) -> float:
        return time.clock_gettime((~self.process.pid << 3) | _CPUCLOCK_SCHED)

    def descriptors(self) -> int:
        return sum(1 for _ in Path(f"/proc/{self.process.pid}/fd").iterdir())

    def stop(self) -> None:
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()


_Start = Callable[..., _Child]


def _run(folder: Path, program: Path, link: Link, column: Column, seconds: float) -> Run:
    with ExitStack() as stack:
        robot, pc = Host("robot"), Host("pc")
        stack.callback(pc.close)
        stack.callback(robot.close)
        wire = _joined(program, robot, pc, link.figures)
        stack.callback(wire.kill)
        bridged = column.transport != "dds"
        logs = [folder / f"{robot}.log" for robot in link.robots]
        for log in logs:
            log.write_text("")
        if column.transport in {"zenoh", "bare"}:  # which have sockets of their own
            for host in (robot, pc):
                _set_congestion_control(host, column.congestion)

        def child(host: Host, *command: str, log: Path | None = None) -> _Child:
            peer = "" if bridged else (_PC if host is robot else _ROBOT)
            started = _Child(host, *command, peer=peer, log=log)
            stack.callback(started.stop)
            return started

        def node(host: Host, what: str, *about: object) -> _Child:
            domain = FAR if host is pc and bridged else NEAR
            return child(host, "-m", "bench.robot_ends", what, str(domain), *map(str, about))

        topics = [each for each in link.topics if not (each.to_robot and column.transport == "bare")]
        parts = [list(part) for _, part in groupby(sorted(topics, key=_process), key=_process)]
        ears = [node(robot if part[0].to_robot else pc, "listen", *part) for part in parts]
        calls = link.calls if column.transport != "bare" else ()
        servers = [node(robot, "serve", *calls)] if calls else []
        for each in (*ears, *servers):
            each.answer()
        if column.transport == "bare":
            sides = _start_bare(child, pc, robot, topics)
        else:
            sides = _start_bridge(child, pc, robot, folder, link, column) if bridged else []
        mouths = [node(pc if part[0].to_robot else robot, "talk", *part) for part in parts]
        if calls:
            caller = node(pc, "call", *calls)
            mouths.append(caller)
            ears.append(caller)
        _wait_until_matched(mouths, [folder / "server.log", *logs])
        time.sleep(3)
        run = _measured(link, wire, mouths, ears, sides, seconds)
        run.lost = sum(len(_LOST.findall(log.read_text())) for log in logs)
        return run


def _process(topic: Spoken) -> tuple[bool, bool]:
    return topic.to_robot, topic.is_large


def _measured(
    link: Link,
    wire: subprocess.Popen[str],
    mouths: Sequence[_Child],
    ears: Sequence[_Child],
    sides: Sequence[_Child],
    seconds: float,
) -> Run:
    # On this signal, `wifi` prints the bytes so far, and counts the gaps from now on.
    wire.send_signal(signal.SIGUSR1)
    cpu = sum(side.cpu() for side in sides)
    for mouth in mouths:
        mouth.tell(f"go {seconds}")
    made = _by_row(link, mouths)
    wire.send_signal(signal.SIGUSR1)
    cpu = sum(side.cpu() for side in sides) - cpu
    descriptors = max((side.descriptors() for side in sides), default=0)
    time.sleep(_DRAINS)
    for ear in ears:
        ear.tell("report")
    heard = _by_row(link, ears)
    wire.terminate()
    assert wire.stdout is not None
    said = [line.split() for line in wire.stdout.read().splitlines()]
    crossed = [int(words[1]) for words in said if words[0] == "bytes"]
    turns = [float(words[2]) for words in said if words[0] == "gap"]
    # The last gap may not have ended.
    gaps = list(zip(turns[::2], [*turns[1::2], float("inf")], strict=False))
    return Run(made, heard, gaps, crossed[1] - crossed[0], cpu, descriptors)


def _by_row(link: Link, ends: Sequence[_Child]) -> dict[str, list[Any]]:
    rows, found = {each.name: each.row for each in link.topics}, dict[str, list[Any]]()
    for end in ends:
        for name, times in end.answer().items():
            found.setdefault(rows.get(name, name), []).extend(times)
    return found


def _start_bridge(child: _Start, pc: Host, robot: Host, folder: Path, link: Link, column: Column) -> Sequence[_Child]:
    _write_sessions(folder, link, column.transport, with_priorities=column.priorities == "with")
    run = ("-c", _BRIDGE, column.congestion, "run", "--no-ui", "--control")
    sides = []
    for host, side in ((pc, "server"), *((robot, name) for name in link.robots)):
        socket, session, log = (folder / f"{side}.{suffix}" for suffix in ("sock", "yaml", "log"))
        sides.append(child(host, *run, str(socket), str(session), log=log))
    return sides


def _start_bare(child: _Start, pc: Host, robot: Host, topics: Sequence[Spoken]) -> Sequence[_Child]:
    spoken = list(map(str, topics))
    receiving = child(pc, "-m", "bench.robot_ends", "publish", f"{FAR}", f"{_PC}:{_PORT}", *spoken)
    receiving.answer()
    return receiving, child(robot, "-m", "bench.robot_ends", "forward", f"{NEAR}", f"{_PC}:{_PORT}", *spoken)


def _joined(program: Path, robot: Host, pc: Host, figures: str) -> subprocess.Popen[str]:
    wire = subprocess.Popen(
        (program, str(robot.pid), _ROBOT, str(pc.pid), _PC, *figures.split()), stdout=subprocess.PIPE, text=True
    )
    assert wire.stdout is not None
    if wire.stdout.readline() != "up\n":
        raise SystemExit("the link does not come up")
    return wire


def _set_congestion_control(host: Host, name: str) -> None:
    try:
        host.run("sysctl", "-qw", f"net.ipv4.tcp_congestion_control={name}")
    except AssertionError as error:  # a namespace may only use what the machine allows everybody
        allowed = "net.ipv4.tcp_allowed_congestion_control"
        raise SystemExit(f"{error}; allow {name} by sysctl -w {allowed}=... on this machine") from None


def _wait_until_matched(mouths: Sequence[_Child], logs: Sequence[Path]) -> None:
    deadline = time.monotonic() + _MATCHES_WITHIN
    while True:
        for mouth in mouths:
            mouth.tell("match")
        if min(mouth.answer()["matched"] for mouth in mouths):
            return
        if time.monotonic() > deadline:
            raise SystemExit("\n".join(["nobody listens", *(log.read_text()[-2000:] for log in logs if log.exists())]))
        time.sleep(0.3)


def _write_sessions(folder: Path, link: Link, transport: str, *, with_priorities: bool) -> None:
    for robot in link.robots:
        key = folder / f"{robot}.key"
        key.write_bytes(base64.urlsafe_b64encode(os.urandom(32)))
        key.chmod(0o600)
    listens = connects = f"server_ip: {_PC}\nserver_port: {_PORT}\n"
    if transport == "zenoh":
        connects = f"server_ip: zenoh\nzenoh: {{connect: [tcp/{_PC}:{_PORT}]}}\n"
        listens = connects.replace("connect:", "listen:")
    lists: dict[str, dict[str, list[str]]] = {robot: {} for robot in link.robots}
    for topic in link.topics:
        lists[topic.robot].setdefault("topics:", []).append(
            f"  - {{topic: {topic.name}"
            f", direction: {f'receive, type: {_TYPE}' if topic.to_robot else 'transmit'}"
            f"{', protocol: udp' if (topic.transport or transport) == 'udp' else ''}"
            f"{f', priority: {topic.priority}' if with_priorities else ''}}}"
        )
    for each in link.calls:
        section = "parameters:" if each.kind == "parameters" else f"{each.kind}s:"
        lists["robot"].setdefault(section, []).append(f"  - {{{each.entry}, provider: client}}")
    clients = "".join(f"  - {{name: {robot}, key_file: {robot}.key}}\n" for robot in lists)
    (folder / "server.yaml").write_text(
        f"name: pc\nrole: server\ndomain_id: {FAR}\n{listens}clients:\n{clients}", encoding="utf-8"
    )
    for robot, sections in lists.items():
        (folder / f"{robot}.yaml").write_text(
            f"name: {robot}\nrole: client\ndomain_id: {NEAR}\nkey_file: {robot}.key\n{connects}"
            + "".join(f"{line}\n" for section, entries in sections.items() for line in (section, *entries)),
            encoding="utf-8",
        )


def _print(link: str, runs: dict[Column, list[Run]], seconds: float) -> None:
    print(f"\n{link}: {LINKS[link].figures}, {seconds:g} s, medians of {len(next(iter(runs.values())))}")
    print(" | ".join(["topic", *map(str, runs)]))
    for row, words in LINKS[link].rows.items():
        cells = []
        for column in runs.values():
            if row not in column[0].made:
                cells.append("–")
                continue
            p50, p99, part = (statistics.median(each) for each in zip(*(run.cell(row) for run in column), strict=True))
            cells.append(f"{p50:,.0f}/{p99:,.0f} {part:.0%}")
        print(" | ".join([words, *cells]))
    print(" | ".join(["MB", *(f"{statistics.median(run.bytes for run in each) / 1e6:.1f}" for each in runs.values())]))
    print(" | ".join(["CPU, s", *(f"{statistics.median(run.cpu for run in each):.1f}" for each in runs.values())]))
    print(" | ".join(["descriptors", *(str(max(run.descriptors for run in each)) for each in runs.values())]))
    print(" | ".join(["link lost", *(str(sum(run.lost for run in each)) for each in runs.values())]))
    sys.stdout.flush()


if __name__ == "__main__":
    main()
