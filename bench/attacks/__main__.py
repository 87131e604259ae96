"""Prints the table: legitimate service before, during and after each attack.

``python -m bench.attacks`` performs them all, ``python -m bench.attacks NAME ...`` some; ``--list`` names them.
Nothing leaves this machine. An attack whose attacker did not do what it should ends the program with exit code 1.
"""

from __future__ import annotations

import os
import signal
import sys
import time

from bench.attacks import by_server, stage
from bench.attacks.attacker import ATTACKS
from tests.network.hosts import Host, NoHostError

COLUMNS = (
    "link, ms", "p50, ms", "p99, ms", "delivered", "latency p99, ms", "answered", "call p99, ms", "CPU, %", "RSS, MB",
    "descriptors", "log, B",
)  # fmt: skip
_OWN_NETWORK = "one-network"
"""Needs more addresses than this machine has: a network namespace of its own."""
_INSIDE = "--inside"


def main() -> int:
    names = sys.argv[1:]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that what runs is ended first
    if names == ["--list"]:
        for name, attack in ATTACKS.items():
            print(f"{name:<18}{attack.what}")
        print(f"{by_server.NAME:<18}{by_server.WHAT}")
        return 0
    if names == [_INSIDE]:
        return _perform(_OWN_NETWORK, "::1")
    print(f"load average {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores\n")
    print(f"| attack | | {' | '.join(COLUMNS)} |")
    print("|---" * (2 + len(COLUMNS)) + "|", flush=True)
    failures = 0
    for name in names or [*ATTACKS, by_server.NAME]:
        if name == by_server.NAME:
            failures += _print_notes(by_server.NAME, *by_server.perform())
        elif name == _OWN_NETWORK:
            failures += _in_own_network()
        else:
            failures += _perform(name, "127.0.0.1")
    return int(failures > 0)


def _perform(name: str, host: str) -> int:
    attack, began = ATTACKS[name], time.monotonic()
    result = stage.perform(name, attack, host)
    for phase, row in result.rows.items():
        print(_row(name if phase == "before" else "", phase, row))
    remarks = result.remarks
    if types := result.tally.get("types"):
        grown = result.rows["after"].server.memory - result.rows["before"].server.memory
        remarks.append(f"{1000 * grown / types:.1f} kB of memory for each type")
    missing = [what for what, least in attack.at_least.items() if result.tally.get(what, 0) < least]
    did = ", ".join(f"{count:,} {what}" for what, count in result.tally.items())
    return _print_notes(name, [f"{did}; {time.monotonic() - began:.0f} s", *remarks], missing)


def _print_notes(name: str, notes: list[str], missing: list[str]) -> int:
    print(f"| | {'; '.join(notes)} |")
    if missing:
        print(f"| | THE ATTACK {name} DID NOT HAPPEN: too few {', '.join(missing)} |")
    sys.stdout.flush()
    return len(missing)


def _row(name: str, phase: str, row: stage.Row) -> str:
    service, server = row.service, row.server
    link = f"{service.link:.0f}" if service.linked else f"none in {service.link:.0f}"
    lost = f" ({service.lost} links lost)" if service.lost else ""
    return (
        f"| {name} | {phase}{lost} | {link} | {service.p50:.1f} | {service.p99:.1f} | {row.delivered:.2f} | "
        f"{row.slowest:.1f} | {row.answered:.2f} | {row.call:.1f} | {server.cpu:.0f} | {server.memory:.0f} | "
        f"{server.descriptors} | {server.log:,} |"
    )


def _in_own_network() -> int:
    try:
        host = Host("attacked")
    except NoHostError as error:
        print(f"| {_OWN_NETWORK} | left out: {error} |")
        return 0
    # The attacker binds addresses of the network that this machine does not have.
    host.run("sh", "-c", "echo 1 > /proc/sys/net/ipv6/ip_nonlocal_bind")
    host.run("ip", "-6", "route", "add", "local", "fd00:1::/64", "dev", "lo")
    return host.start(sys.executable, "-m", "bench.attacks", _INSIDE).wait()


if __name__ == "__main__":
    sys.exit(main())
