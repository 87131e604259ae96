"""Profile of a message's CPU time: ``python -m bench.profile [tcp|udp|zenoh] [RATE] [SIZE]``. Needs Linux's `perf`.

Prints, for the relay and for each side of the bridge, µs a message by thread and by code: the kernel, DDS, the cipher,
Python itself.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

from bench import bed

from rsb_extras.bench import loopback

if TYPE_CHECKING:
    from collections.abc import Mapping
    from contextlib import AbstractContextManager

_SECONDS = 6.0
_SAMPLES_A_SECOND = 999  # not 1,000, which would be in step with timers
_PARTS = (
    ("kernel", "the kernel"),
    ("vmlinux", "the kernel"),
    ("libfast", "DDS"),
    ("libr", "DDS"),  # librcl, librmw, librosidl and their relatives
    ("_rclpy", "DDS"),
    ("zenoh", "Zenoh"),
    ("_rust", "cipher"),
    ("libcrypto", "cipher"),
    ("libpython", "Python"),
    ("python", "Python"),
)
_OTHER = "libc and others"
"""malloc, memcpy, locks, clocks, and Python's own modules in C."""


def main() -> None:
    if shutil.which("perf") is None:
        sys.exit("bench.profile needs perf (apt install linux-perf, or linux-tools-generic)")
    arguments = sys.argv[1:] + ["tcp", "5000", "2500"][len(sys.argv) - 1 :]
    protocol, rate, size = arguments[0], float(arguments[1]), int(arguments[2])
    _show(bed.relayed(), ("relay",), rate, size)
    zenoh: loopback.ZenohPath = "peer" if protocol == "zenoh" else ""
    sides = loopback.bridged(protocol, bed.NEAR, bed.FAR, side=_named, zenoh=zenoh)
    _show(sides, ("sending side", "receiving side"), rate, size)


def _named(session: Path) -> bed.Process:
    """Return a side whose threads the kernel knows by name."""
    log = session.with_suffix(".log")
    return bed.Process("-m", "bench.named_threads", "run", "--no-ui", str(session), log=log)


def _show(making: AbstractContextManager[bed.Bed], names: tuple[str, ...], rate: float, size: int) -> None:
    with making as between, tempfile.TemporaryDirectory(prefix="rsb-profile-") as folder:
        between.send(rate, 1.0, size)
        files = [Path(folder, f"{number}.data") for number in range(len(names))]
        recording = [
            subprocess.Popen(
                ["perf", "record", "-q", "-F", str(_SAMPLES_A_SECOND), "-o", file, "-p", str(process.pid)],
                stderr=subprocess.DEVNULL,
            )
            for file, process in zip(files, between.between, strict=True)
        ]
        run = between.send(rate, _SECONDS, size)
        for each in recording:
            each.terminate()
            each.wait()
        for name, file, cpu in zip(names, files, run.sides, strict=False):
            a_message = cpu * 1e6 / run.sent
            print(f"\n{name}: {a_message:.0f} µs a message ({run.received:,} of {run.sent:,} came)")
            _table(_shares(file), a_message)


def _shares(file: Path) -> Mapping[str, Mapping[str, float]]:
    """Return the shares of a process's time, by thread and part."""
    command = ["perf", "report", "-q", "-i", str(file), "--stdio", "-g", "none", "--sort", "comm,dso", "-t", "\t"]
    report = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    shares: defaultdict[str, defaultdict[str, float]] = defaultdict(lambda: defaultdict(float))
    for line in filter(str.strip, report.splitlines()):
        share, thread, library = (word.strip() for word in line.split("\t"))
        part = next((part for start, part in _PARTS if library.strip("[]").startswith(start)), _OTHER)
        shares[thread][part] += float(share.rstrip("%")) / 100
    return shares


def _table(shares: Mapping[str, Mapping[str, float]], a_message: float) -> None:
    parts = [*dict.fromkeys(part for _, part in _PARTS), _OTHER]
    print(f"{'thread':16}" + "".join(f"{part:>16}" for part in parts))
    for thread, its in sorted(shares.items(), key=lambda item: -sum(item[1].values())):
        if sum(its.values()) >= 0.01:
            print(f"{thread:16}" + "".join(f"{its.get(part, 0.0) * a_message:>16.1f}" for part in parts))


if __name__ == "__main__":
    main()
