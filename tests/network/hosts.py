"""Machines on a network of their own: Linux network namespaces, joined by veth cables that can be cut and slowed.

Each has its own `/dev/shm` too, or DDS would reach from one to the other by shared memory. Both last as long as the
process that holds them, which dies with this one, so nothing is left behind.
"""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]

_DIES_WITH_US = ("setpriv", "--pdeathsig", "KILL")
_HOLD = "mount -t tmpfs shm /dev/shm && ip link set lo up && nft list ruleset && echo up && exec sleep infinity"


class NoHostError(Exception):
    """This machine does not let us make others; the message says why."""


class Host:
    """A machine.

    Attributes:
        devices: network devices so far.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.devices = 0
        try:
            self._holder = subprocess.Popen(
                ("unshare", "--net", "--mount", *_DIES_WITH_US, "sh", "-c", _HOLD),
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        except FileNotFoundError as error:
            raise NoHostError(f"{error.filename} is missing (apt install util-linux)") from None
        assert self._holder.stdout is not None
        assert self._holder.stderr is not None
        if self._holder.stdout.readline() != "up\n":
            raise NoHostError(self._holder.communicate()[1].strip())

    @property
    def pid(self) -> int:
        """The id of the process that holds its namespaces."""
        return self._holder.pid

    def start(self, *command: str, **how: Any) -> subprocess.Popen[str]:
        """Start a program on it, in the project's folder; its process id is the program's own."""
        enter = ("nsenter", "--target", str(self.pid), "--net", "--mount", f"--wdns={ROOT}")
        return subprocess.Popen((*enter, *_DIES_WITH_US, *command), text=True, **how)

    def run(self, *command: str) -> str:
        """Run a command and return its output, or raise AssertionError if it fails."""
        process = self.start(*command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        printed = process.communicate(timeout=60)[0]
        assert process.returncode == 0, f"{self.name}: {' '.join(command)}: {printed}"
        return printed

    def address(self, device: str, *addresses: str) -> None:
        """Give a device addresses, each with its prefix length."""
        for address in addresses:
            self.run("ip", "address", "add", address, "dev", device, *(("nodad",) if ":" in address else ()))

    def route(self, gateway: str) -> None:
        """Send everything that has no better way to a gateway."""
        self.run("ip", "route", "replace", "default", "via", gateway)

    def nft(self, rules: str) -> None:
        """Add to its firewall (nft(8))."""
        self.run("nft", rules)

    def wall(self, *rules: str) -> None:
        """Filter its incoming packets, until its table ``inet wall`` is deleted."""
        chain = "add table inet wall; add chain inet wall in { type filter hook input priority 0; };"
        self.nft(chain + ";".join(f"add rule inet wall in {rule}" for rule in rules))

    def count(self, counter: str) -> int:
        """One of the kernel's counters, like ``Ip6FragCreates`` (snmp(7) names)."""
        words = self.run("cat", "/proc/net/snmp6").split()
        counters = dict(zip(words[::2], words[1::2], strict=True))
        lines = [line.split() for line in self.run("cat", "/proc/net/snmp").splitlines()]
        for names, values in zip(lines[::2], lines[1::2], strict=True):
            counters.update({names[0][:-1] + name: value for name, value in zip(names[1:], values[1:], strict=True)})
        return int(counters[counter])

    def close(self) -> None:
        """Let it go, with all that still runs on it."""
        self._holder.kill()
        self._holder.communicate()


class Cable:
    """Joins two hosts.

    Attributes:
        ends: each a host and its device there.
    """

    def __init__(self, one: Host, other: Host) -> None:
        self.ends = tuple((host, f"eth{host.devices}") for host in (one, other))
        (_, device), (_, far_device) = self.ends
        one.run("ip", "link", "add", device, "type", "veth", "peer", "name", far_device, "netns", str(other.pid))
        for host, name in self.ends:
            host.devices += 1
            host.run("ip", "link", "set", name, "up")

    def address(self, *addresses: tuple[str, str]) -> None:
        """Give both ends addresses, the first host's first."""
        for pair in addresses:
            for (host, device), address in zip(self.ends, pair, strict=True):
                host.address(device, address)

    def mtu(self, size: int) -> None:
        """Carry no larger packets."""
        for host, device in self.ends:
            host.run("ip", "link", "set", device, "mtu", str(size))

    def single(self) -> None:
        """Carry single packets, as a real wire does, and not many in one frame that its end would divide."""
        for host, device in self.ends:
            host.run("ip", "link", "set", device, "gso_max_segs", "1")

    def slow(self, rate: str, queue: str) -> None:
        """Carry no more than a rate (``1mbit``) either way, behind a queue (``100ms``) (tc-tbf(8))."""
        for host, device in self.ends:
            host.run("tc", "qdisc", "add", "dev", device, "root", *f"tbf rate {rate} burst 4kb latency {queue}".split())

    def lose(self, percent: int) -> None:
        """Lose a share of the packets, both ways."""
        for host, device in self.ends:
            rule = f"numgen random mod 100 < {percent} drop"
            host.nft(
                f"add table netdev lose_{device};"
                f"add chain netdev lose_{device} in {{ type filter hook ingress device {device} priority 0; }};"
                f"add rule netdev lose_{device} in {rule}"
            )

    def lose_no_more(self) -> None:
        """Carry all packets again."""
        for host, device in self.ends:
            host.nft(f"delete table netdev lose_{device}")

    def cut(self) -> None:
        """Carry nothing, and tell nobody: as a cable behind a switch, or a machine without power."""
        for host, device in self.ends:
            everything = f"type filter hook ingress device {device} priority 0; policy drop;"
            host.nft(f"add table netdev cut_{device}; add chain netdev cut_{device} in {{ {everything} }}")

    def mend(self) -> None:
        """Carry again."""
        for host, device in self.ends:
            host.nft(f"delete table netdev cut_{device}")
