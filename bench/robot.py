"""Measures what a robot's topics have of a thin link: ``python -m bench.robot`` prints a table for each link.

A robot with nav2 and an operator's PC stand in network namespaces of their own. Between them is a Wi-Fi of 20
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
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench.bed import FAR, NEAR, ROOT
from bench.robot_ends import GOAL, NODE, PARAMETERS, RESULT
from tests.network.hosts import Host, NoHostError

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
_NO_BRIDGE = ("bare", "dds")
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
    """

    name: str
    rate: float
    size: int
    priority: str = "normal"
    reliability: str = "reliable"
    transport: str = ""

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
        """What is measured of it."""
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
    def rows(self) -> dict[str, str]:
        """What is measured, in words, by its name."""
        topics = {each.name: f"{each.name} {each.rate:g} Hz × {each.size:,}" for each in self.topics}
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
}


@dataclass
class Run:
    """The messages of one run.

    Attributes:
        made: when (ns) each message was published, or call made, by name.
        heard: when (ns) each that arrived, or was answered, was made and heard.
        gaps: when (s) gaps began and ended.
        bytes: that crossed to the PC.
        cpu: s of both sides' processors.
        lost: how often the link was lost.
    """

    made: dict[str, list[int]]
    heard: dict[str, list[list[int]]]
    gaps: list[tuple[float, float]]
    bytes: int
    cpu: float
    lost: int

    def cell(self, topic: str) -> tuple[float, float, float]:
        """Return p50 and p99 (ms) and the part that arrived."""
        delays = sorted(
            (heard - made) / 1e6
            for made, heard in self.heard.get(topic, ())
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
        self.process = host.start(
            sys.executable, *command, stdin=subprocess.PIPE, stdout=output, stderr=output, env={**os.environ, **finds}
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
        (folder / "client.log").write_text("")
        if column.transport in {"zenoh", "bare"}:  # which have sockets of their own
            for host in (robot, pc):
                _set_congestion_control(host, column.congestion)

        def child(host: Host, *command: str, log: Path | None = None) -> _Child:
            peer = "" if bridged else (_PC if host is robot else _ROBOT)
            started = _Child(host, *command, peer=peer, log=log)
            stack.callback(started.stop)
            return started

        sizes = [part for large in (False, True) if (part := [each for each in link.topics if each.is_large == large])]
        domain = FAR if bridged else NEAR
        ears = [child(pc, "-m", "bench.robot_ends", "listen", str(domain), *map(str, part)) for part in sizes]
        calls = [str(each) for each in link.calls if column.transport != "bare"]
        servers = [child(robot, "-m", "bench.robot_ends", "serve", str(NEAR), *calls)] if calls else []
        for each in (*ears, *servers):
            each.answer()
        if column.transport == "bare":
            sides = _start_bare(child, pc, robot, link.topics)
        else:
            sides = _start_bridge(child, pc, robot, folder, link, column) if bridged else []
        mouths = [child(robot, "-m", "bench.robot_ends", "talk", str(NEAR), *map(str, part)) for part in sizes]
        if calls:
            caller = child(pc, "-m", "bench.robot_ends", "call", str(domain), *calls)
            mouths.append(caller)
            ears.append(caller)
        _wait_until_matched(mouths, folder)
        time.sleep(3)
        wire.send_signal(signal.SIGUSR1)
        cpu = sum(side.cpu() for side in sides)
        for mouth in mouths:
            mouth.tell(f"go {seconds}")
        made = {topic: times for mouth in mouths for topic, times in mouth.answer().items()}
        wire.send_signal(signal.SIGUSR1)
        cpu = sum(side.cpu() for side in sides) - cpu
        time.sleep(_DRAINS)
        heard: dict[str, list[list[int]]] = {}
        for ear in ears:
            ear.tell("report")
            heard |= ear.answer()  # type: ignore[arg-type]
        wire.terminate()
        assert wire.stdout is not None
        said = [line.split() for line in wire.stdout.read().splitlines()]
        crossed = [int(words[1]) for words in said if words[0] == "bytes"]
        turns = [float(words[2]) for words in said if words[0] == "gap"]
        gaps = list(zip(turns[::2], [*turns[1::2], float("inf")], strict=False))
        lost = len(_LOST.findall((folder / "client.log").read_text()))
        return Run(made, heard, gaps, crossed[1] - crossed[0], cpu, lost)


def _start_bridge(child: _Start, pc: Host, robot: Host, folder: Path, link: Link, column: Column) -> Sequence[_Child]:
    _write_sessions(folder, link, column.transport, with_priorities=column.priorities == "with")
    run = ("-c", _BRIDGE, column.congestion, "run", "--no-ui", "--control")
    sides = []
    for host, side in ((pc, "server"), (robot, "client")):
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


def _wait_until_matched(mouths: Sequence[_Child], folder: Path) -> None:
    deadline = time.monotonic() + _MATCHES_WITHIN
    while True:
        for mouth in mouths:
            mouth.tell("match")
        if min(mouth.answer()["matched"] for mouth in mouths):
            return
        if time.monotonic() > deadline:
            logs = [folder / f"{side}.log" for side in ("server", "client")]
            raise SystemExit("\n".join(["nobody listens", *(log.read_text()[-2000:] for log in logs if log.exists())]))
        time.sleep(0.3)


def _write_sessions(folder: Path, link: Link, transport: str, *, with_priorities: bool) -> None:
    key = folder / "bench.key"
    key.write_bytes(base64.urlsafe_b64encode(os.urandom(32)))
    key.chmod(0o600)
    common = "name: robot\nkey_file: bench.key\n"
    listens = connects = f"server_ip: {_PC}\nserver_port: {_PORT}\n"
    if transport == "zenoh":
        connects = f"server_ip: zenoh\nzenoh: {{connect: [tcp/{_PC}:{_PORT}]}}\n"
        listens = connects.replace("connect:", "listen:")
    lists = {
        "topics:": [
            f"  - {{topic: {each.name}, direction: transmit"
            f"{', protocol: udp' if (each.transport or transport) == 'udp' else ''}"
            f"{f', priority: {each.priority}' if with_priorities else ''}}}"
            for each in link.topics
        ]
    }
    for each in link.calls:
        section = "parameters:" if each.kind == "parameters" else f"{each.kind}s:"
        lists.setdefault(section, []).append(f"  - {{{each.entry}, provider: client}}")
    (folder / "server.yaml").write_text(f"role: server\ndomain_id: {FAR}\n{common}{listens}")
    (folder / "client.yaml").write_text(
        f"role: client\ndomain_id: {NEAR}\n{common}{connects}"
        + "".join(f"{line}\n" for section, entries in lists.items() for line in (section, *entries))
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
    print(" | ".join(["link lost", *(str(sum(run.lost for run in each)) for each in runs.values())]))
    sys.stdout.flush()


if __name__ == "__main__":
    main()
