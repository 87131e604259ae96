"""Prints the load of one side of a bridge on a small computer: ``python -m bench.small [rounds]``, 40 s a round.

Memory, the time from the start of the process until it listens or is linked, and, while it is linked and idle, the CPU
time and the wake-ups of each thread. Two headless sides between two domains carry four topics with silent publishers
and subscribers. For comparison, a node of rclpy that does nothing at all shows the least possible load.

The run has its own folder for Python's bytecode, filled by a first start that does not count, as in an installed
program.
"""

from __future__ import annotations

import base64
import os
import re
import signal
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench import bed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

ROUNDS = 3
TOPICS = 4
_WITHIN = 30.0
_SETTLES = 12.0
"""Seconds after the start in which one-time work ends."""
_IDLE = 20.0
_LOOK_EVERY = 0.002
_LISTENS = "0A"  # as in proc_net(5)
_PORT = re.compile(r"(?<=dds).*")  # of Fast DDS: by transport and port
_BARE = "node"
_SIDES = ("server", "client")


@dataclass(frozen=True, slots=True)
class Taken:
    """The load of one process.

    Attributes:
        start: s until it listened, was linked, or had joined its domain.
        work: CPU time in s until then, which a busy machine changes less.
        resident: memory in MB, including shared memory (RSS).
        own: memory in MB that it does not share (USS).
        cpu: % of a core, by the thread's name.
        wakes: wake-ups a second, by the thread's name.
    """

    start: float
    work: float
    resident: float
    own: float
    cpu: Mapping[str, float]
    wakes: Mapping[str, float]

    @property
    def totals(self) -> tuple[float, ...]:
        """All of it, of all threads together."""
        return self.start, self.work, self.resident, self.own, sum(self.cpu.values()), sum(self.wakes.values())


class Thread(NamedTuple):
    """A thread: its name, the CPU time (s) that it has used, and how often it has slept."""

    name: str
    cpu: float
    slept: int


def main() -> None:
    match sys.argv[1:]:
        case ["node"]:
            _node()
        case ["ends"]:
            _ends()
        case []:
            report(ROUNDS)
        case [rounds]:
            report(int(rounds))


def report(rounds: int) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that what runs is ended first
    with tempfile.TemporaryDirectory() as name:
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ["PYTHONPYCACHEPREFIX"] = f"{name}/bytecode"
        os.environ["XDG_STATE_HOME"] = f"{name}/state"
        _measure(Path(name), settles=0.0, idle=0.0)
        taken = [_measure(Path(name), settles=_SETTLES, idle=_IDLE) for _ in range(rounds)]
    _print(taken)


def _measure(folder: Path, *, settles: float, idle: float) -> dict[str, Taken]:
    port = bed.free_port()
    _write_sessions(folder, port)
    starts: dict[str, tuple[float, float]] = {}
    with ExitStack() as running:

        def start(name: str, has_started: Callable[[bed.Process], bool], *command: str) -> bed.Process:
            began = time.monotonic()
            process = running.enter_context(bed.Process(*command, log=folder / f"{name}.log"))
            while not has_started(process):
                if time.monotonic() - began > _WITHIN:
                    raise SystemExit(f"{name} has not started: {(folder / f'{name}.log').read_text()}")
                time.sleep(_LOOK_EVERY)
            took = time.monotonic() - began
            starts[name] = took, sum(thread.cpu for thread in _threads(process.pid).values())
            return process

        running.enter_context(bed.Process("-m", "bench.small", "ends")).line()
        log = folder / "client.log"
        processes = {
            _BARE: start(_BARE, lambda _: (folder / f"{_BARE}.log").stat().st_size > 0, "-m", "bench.small", _BARE),
            "server": start("server", lambda _: _listens(port), *_command(folder / "server.yaml")),
            "client": start("client", lambda _: "linked with" in log.read_text(), *_command(folder / "client.yaml")),
        }
        time.sleep(settles)
        before = {name: _threads(process.pid) for name, process in processes.items()}
        began = time.monotonic()
        time.sleep(idle)
        seconds = max(time.monotonic() - began, 1e-3)
        return {name: _taken(process, starts[name], before[name], seconds) for name, process in processes.items()}


def _taken(process: bed.Process, start: tuple[float, float], before: dict[int, Thread], seconds: float) -> Taken:
    cpu: dict[str, float] = defaultdict(float)
    wakes: dict[str, float] = defaultdict(float)
    for number, thread in _threads(process.pid).items():
        earlier = before.get(number, Thread(thread.name, 0.0, 0))
        cpu[thread.name] += (thread.cpu - earlier.cpu) / seconds * 100
        wakes[thread.name] += (thread.slept - earlier.slept) / seconds
    return Taken(*start, process.memory(), _own_memory(process.pid), cpu, wakes)


def _command(session: Path) -> tuple[str, ...]:
    return ("-m", "bench.named_threads", "run", "--no-ui", str(session))


def _write_sessions(folder: Path, port: int) -> None:
    common = f"name: small\nserver_ip: 127.0.0.1\nserver_port: {port}\nkey_file: small.key\n"
    key = folder / "small.key"
    key.unlink(missing_ok=True)
    key.write_bytes(base64.urlsafe_b64encode(os.urandom(32)))
    key.chmod(0o600)
    (folder / "server.yaml").write_text(f"role: server\ndomain_id: {bed.FAR}\n{common}")
    topics = "".join(
        f"  - {{topic: /small_{number}, direction: {direction}, type: std_msgs/msg/String, protocol: {protocol}}}\n"
        for number, (direction, protocol) in enumerate(
            (direction, protocol) for direction in ("transmit", "receive") for protocol in ("tcp", "udp")
        )
    )
    (folder / "client.yaml").write_text(f"role: client\ndomain_id: {bed.NEAR}\n{common}topics:\n{topics}")


def _listens(port: int) -> bool:
    ends = (line.split()[1:4:2] for line in Path("/proc/net/tcp").read_text().splitlines()[1:])
    return any(state == _LISTENS and address.endswith(f":{port:04X}") for address, state in ends)


def _threads(pid: int) -> dict[int, Thread]:
    """Return the figures of each thread by its number. The kernel counts CPU time in ns (proc_pid_schedstat)."""
    found = {}
    for thread in Path(f"/proc/{pid}/task").iterdir():
        status = (thread / "status").read_text()
        name = status.split("Name:")[1].split("\n")[0].strip()
        slept = int(status.split("\nvoluntary_ctxt_switches:")[1].split()[0])
        cpu = int((thread / "schedstat").read_text().split()[0]) / 1e9
        found[int(thread.name)] = Thread(_PORT.sub("", name), cpu, slept)
    return found


def _own_memory(pid: int) -> float:
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_")) / 1000


def _node() -> None:
    """Run a node that does nothing, for the least possible load."""
    import rclpy  # noqa: PLC0415 -- no other part of the bench may load it

    rclpy.init(domain_id=bed.FAR)
    node = rclpy.create_node("bare")
    print("joined", flush=True)
    rclpy.spin(node)


def _ends() -> None:
    """Silent publishers and subscribers of the topics, in both domains."""
    import rclpy  # noqa: PLC0415 -- as above
    from std_msgs.msg import String  # noqa: PLC0415 -- as above

    kept = []
    for domain in (bed.NEAR, bed.FAR):
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        node = rclpy.create_node("ends", context=context)
        for number in range(TOPICS):
            kept.append(node.create_publisher(String, f"/small_{number}", 10))
            kept.append(node.create_subscription(String, f"/small_{number}", print, 10))
    print("there", flush=True)
    signal.pause()


def _print(rounds: list[dict[str, Taken]]) -> None:
    median = statistics.median
    print(f"Medians of {len(rounds)}; the ratios are to a node of rclpy's that does nothing")
    _row("", "start, s", "", "its CPU", "", "RSS, MB", "", "own, MB", "", "idle, %", "", "wakes/s", "")
    floor: list[float] = []
    for name in (_BARE, *_SIDES):
        columns = zip(*(taken[name].totals for taken in rounds), strict=True)
        values = [median(column) for column in columns]
        floor = floor or values
        pairs = ((f"{value:.2f}", f"{value / least:.2f}") for value, least in zip(values, floor, strict=True))
        _row(name, *chain.from_iterable(pairs))
    processes = (_BARE, *_SIDES)
    names = sorted({thread for taken in rounds for each in taken.values() for thread in each.wakes})
    print("\nby thread: wakes a second, and ms of CPU a second")
    _row("", *chain.from_iterable([name, ""] for name in processes))
    for thread in names:
        cells: list[str] = []
        for name in processes:
            wakes = median(taken[name].wakes.get(thread, 0.0) for taken in rounds)
            cpu = median(taken[name].cpu.get(thread, 0.0) for taken in rounds)
            cells += [f"{wakes:.2f}", f"{cpu * 10:.2f}"]
        _row(thread, *cells)


def _row(*cells: object) -> None:
    print(f"{cells[0]!s:<16}" + " ".join(f"{cell!s:>8}" for cell in cells[1:]))


if __name__ == "__main__":
    main()
