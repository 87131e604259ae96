"""Measures what a robot's topics have of a thin link: ``python -m bench.robot`` prints a table for each link.

A robot with nav2 and an operator's PC have network namespaces of their own. Between them is a Wi-Fi of 20
Mbit/s that delays by 20 ± 15 ms, loses 2 % of the packets and all for 3 s of every 30 s, or a tunnel of 5 kB/s that
keeps 4.4 MB (`wifi.c`). Plain nodes publish on the robot and listen on the PC, and a bridge is between them: ours over
``tcp``, ``udp`` or ``zenoh``, or ``zenoh-bridge``, which is zenoh-bridge-ros2dds. The column ``dds`` has no bridge: the
nodes find each other by address. The column ``bare`` has two processes that only pass each topic on over a TCP
connection. A cell has the latencies' p50 and p99 in ms and the part of the messages that arrived. Messages of a gap,
and of the 3 s after it, count as arrived or lost only. Of calls, it is the time until the answer and the part that was
answered.

A column names what differs from how a bridge comes: ``tcp+equal`` is without the topics' priorities,
``zenoh-bridge+bbr+priorities+tls`` with BBR, those priorities and TLS. Where no congestion control of TCP is named,
the kernel's is Linux's default, and our bridge takes the one it prefers.

It needs root, /dev/net/tun, a C compiler and iproute2, and takes the seconds of a run and some 15 s for each column.
"""

from __future__ import annotations

import argparse
import base64
import json
import math
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
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from bench import zenoh_bridge
from bench.bed import FAR, NEAR, ROOT
from bench.robot_links import LINKS, Link, Spoken
from tests.network.hosts import Host, NoHostError

from rsb_bridge.ros.memory import LARGE_MESSAGES

if TYPE_CHECKING:
    from collections.abc import Sequence

_ROBOT, _PC = "10.98.0.1", "10.98.0.2"
_PORT = 49152
_CONGESTION_CONTROLS = Path("/proc/sys/net/ipv4/tcp_available_congestion_control").read_text(encoding="ascii").split()
_OF_LINUX = "cubic"
_CPUCLOCK_SCHED = 2  # clock_getcpuclockid(3), as Linux makes the id of a process's clock
_AFTER_GAP = 3.0
_DRAINS = 5.0
"""s in which the last messages arrive after the robot has stopped."""
_MATCHES_WITHIN = 30.0
_PROFILES = {variable: str(ROOT / "configs" / name) for variable, name in LARGE_MESSAGES.items()}
"""Without it, DDS hands on hardly one image of 6 MB a minute in full, and small topics late, on the same machine."""
_TYPE = "std_msgs/msg/String"
_LOST = re.compile("link with the server at .* lost: ")
_BRIDGE = """
import sys
from rsb_bridge.transport import tcp
tcp.BBR = sys.argv.pop(1)  # what a column asks for, instead of the one that the bridge prefers
from rsb_console.cli import main
sys.exit(main(sys.argv[1:]))
"""


_WAYS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("tcp", "udp", "zenoh"), ("equal",)),
    zenoh_bridge.NAME: ("priorities", "tls"),
    "bare": (),
    "dds": (),
}
"""The ways for messages to cross, with their options beside a congestion control."""
_ZENOH_PRIORITIES = {"high": 2, "low": 6}  # of 1 to 7; 5 is the default


class Column(NamedTuple):
    """A way of `_WAYS` with the options that were chosen."""

    way: str
    options: tuple[str, ...] = ()

    @classmethod
    def of(cls, text: str) -> Self:
        """Read ``way+option+option``, or end this process with what is allowed."""
        way, *options = text.split("+")
        if way not in _WAYS:
            raise SystemExit(f"--columns {text}: there are {', '.join(_WAYS)}")
        allowed = (*_WAYS[way], *(_CONGESTION_CONTROLS if way != "dds" else ()))
        if unknown := [each for each in options if each not in allowed]:
            raise SystemExit(f"--columns {text}: {way} has no {unknown[0]}, but {', '.join(allowed) or 'no option'}")
        if way == zenoh_bridge.NAME:
            zenoh_bridge.check_built()
        return cls(way, tuple(options))

    @property
    def congestion(self) -> str:
        """The congestion control of TCP that was chosen, or an empty string."""
        return next((each for each in self.options if each in _CONGESTION_CONTROLS), "")

    @property
    def is_ours(self) -> bool:
        return self.way in {"tcp", "udp", "zenoh"}

    def __str__(self) -> str:
        return "+".join((self.way, *self.options))


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
        lost: how often our bridge's link was lost.
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

    def as_json(self) -> dict[str, Any]:
        cells = {row: self.cell(row) for row in self.made}
        rows = {
            # JSON has no NaN: nothing arrived outside of the gaps.
            row: {"p50": None if math.isnan(p50) else p50, "p99": None if math.isnan(p99) else p99, "part": part}
            for row, (p50, p99, part) in cells.items()
        }
        return {"rows": rows, "bytes": self.bytes, "cpu": self.cpu, "lost": self.lost}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--links", default="wifi,tunnel", help=", ".join(LINKS))
    parser.add_argument("--columns", default="tcp,udp,zenoh,bare,dds", help=f"{', '.join(_WAYS)}, each with +option")
    parser.add_argument("--seconds", type=float, default=68.0)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--json", type=Path, help="write the figures of all runs to this file")
    options = parser.parse_args()
    columns = [Column.of(each) for each in options.columns.split(",")]
    if unknown := [each for each in options.links.split(",") if each not in LINKS]:
        raise SystemExit(f"--links {unknown[0]}: there are {', '.join(LINKS)}")
    found: dict[str, dict[str, list[Any]]] = {}
    with tempfile.TemporaryDirectory(prefix="rsb-robot-") as name:
        folder = Path(name)
        program = _built(folder)
        for link in options.links.split(","):
            runs: dict[Column, list[Run]] = {column: [] for column in columns}
            for _ in range(options.rounds):
                for column in columns:
                    try:
                        run = _run(folder, program, LINKS[link], column, options.seconds)
                    except NoHostError as error:
                        raise SystemExit(f"no namespaces: {error}; run this as root") from None
                    runs[column].append(run)
                    found.setdefault(link, {}).setdefault(str(column), []).append(run.as_json())
                    if options.json:
                        options.json.write_text(json.dumps(found, indent=1), encoding="utf-8")
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
        finds = {"ROS_STATIC_PEERS": peer, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
        near = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        variables = {**os.environ, **_PROFILES, **(finds if peer else near)}
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
        bridged = column.way != "dds"
        logs = [folder / f"{robot}.log" for robot in link.robots]
        for log in logs:
            log.write_text("")
        for host in (robot, pc):
            _set_congestion_control(host, column.congestion or _OF_LINUX)

        def child(host: Host, *command: str, log: Path | None = None) -> _Child:
            peer = "" if bridged else (_PC if host is robot else _ROBOT)
            started = _Child(host, *command, peer=peer, log=log)
            stack.callback(started.stop)
            return started

        def node(host: Host, what: str, *about: object) -> _Child:
            domain = FAR if host is pc and bridged else NEAR
            return child(host, "-m", "bench.robot_ends", what, str(domain), *map(str, about))

        topics = [each for each in link.topics if not (each.to_robot and column.way == "bare")]
        parts = [list(part) for _, part in groupby(sorted(topics, key=_process), key=_process)]
        ears = [node(robot if part[0].to_robot else pc, "listen", *part) for part in parts]
        calls = link.calls if column.way != "bare" else ()
        servers = [node(robot, "serve", *calls)] if calls else []
        for each in (*ears, *servers):
            each.answer()
        if column.way == "bare":
            sides = _start_bare(child, pc, robot, topics)
        elif column.way == zenoh_bridge.NAME:
            sides = _start_zenoh_bridge(child, pc, robot, folder, link, column)
        else:
            sides = _start_bridge(child, pc, robot, folder, link, column) if bridged else []
        mouths = [node(pc if part[0].to_robot else robot, "talk", *part) for part in parts]
        callers = [node(pc, "call", *calls)] if calls else []
        # The other bridge may not bring what is called.
        _wait_until_matched(mouths, [] if column.way == zenoh_bridge.NAME else callers, [folder / "server.log", *logs])
        mouths += callers
        ears += callers
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
    _write_sessions(folder, link, column.way, with_priorities="equal" not in column.options)
    program = ("-c", _BRIDGE, column.congestion) if column.congestion else ("-m", "rsb_console")
    run = (*program, "run", "--no-ui", "--control")
    sides = []
    for host, side in ((pc, "server"), *((robot, name) for name in link.robots)):
        socket, session, log = (folder / f"{side}.{suffix}" for suffix in ("sock", "yaml", "log"))
        sides.append(child(host, *run, str(socket), str(session), log=log))
    return sides


def _start_zenoh_bridge(
    child: _Start, pc: Host, robot: Host, folder: Path, link: Link, column: Column
) -> Sequence[_Child]:
    endpoint, keys = f"tcp/{_PC}:{_PORT}", dict[str, object]()
    if "tls" in column.options:
        endpoint, keys = f"tls/{_PC}:{_PORT}", zenoh_bridge.tls_keys(folder)
    if "priorities" in column.options:
        priorities = ((each.name, _ZENOH_PRIORITIES.get(each.priority)) for each in link.topics)
        keys["plugins/ros2dds/pub_priorities"] = [f"{name}={priority}" for name, priority in priorities if priority]
    return [
        child(host, *zenoh_bridge.arguments(domain, part, endpoint, keys), log=folder / f"{name}.log")
        for host, domain, part, name in ((pc, FAR, "listen", "server"), (robot, NEAR, "connect", "robot"))
    ]


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


def _wait_until_matched(mouths: Sequence[_Child], callers: Sequence[_Child], logs: Sequence[Path]) -> None:
    deadline = time.monotonic() + _MATCHES_WITHIN
    while True:
        for each in (*mouths, *callers):
            each.tell("match")
        if min([each.answer()["matched"] for each in (*mouths, *callers)]):
            return
        if time.monotonic() > deadline:
            raise SystemExit("\n".join(["nobody listens", *(log.read_text()[-2000:] for log in logs if log.exists())]))
        time.sleep(0.3)


def _write_sessions(folder: Path, link: Link, way: str, *, with_priorities: bool) -> None:
    for robot in link.robots:
        key = folder / f"{robot}.key"
        key.write_bytes(base64.urlsafe_b64encode(os.urandom(32)))
        key.chmod(0o600)
    listens = connects = f"server_ip: {_PC}\nserver_port: {_PORT}\n"
    if way == "zenoh":
        connects = f"server_ip: zenoh\nzenoh: {{connect: [tcp/{_PC}:{_PORT}]}}\n"
        listens = connects.replace("connect:", "listen:")
    lists: dict[str, dict[str, list[str]]] = {robot: {} for robot in link.robots}
    for topic in link.topics:
        lists[topic.robot].setdefault("topics:", []).append(
            f"  - {{topic: {topic.name}"
            f", direction: {f'receive, type: {_TYPE}' if topic.to_robot else 'transmit'}"
            f"{', protocol: udp' if (topic.transport or way) == 'udp' else ''}"
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
    lost = (str(sum(run.lost for run in its)) if column.is_ours else "–" for column, its in runs.items())
    print(" | ".join(["link lost", *lost]))
    sys.stdout.flush()


if __name__ == "__main__":
    main()
