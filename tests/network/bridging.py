"""`rsb-console run --no-ui` as it is installed, on two hosts, and what it says."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from rsb_bridge.keys import write_key
from rsb_bridge.snapshot import Ledger
from tests.network.node import Node
from tests.support.bridge import balance
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from tests.network.hosts import Host

PORT = 49152
_COMMAND = Path(sys.executable).with_name("rsb-console")
_STOPS_WITHIN = 6.0
_LEDGER_FIELDS = ("offered", "delivered", "throttled", "expired", "in_flight", "dropped", "lost_in_dds")


class Program:
    """The program on a host; its log is read from a file.

    Attributes:
        pid: its process id.
    """

    def __init__(self, host: Host, session: Path) -> None:
        self._log = session.with_suffix(".log")
        self._seen = self._log.stat().st_size if self._log.exists() else 0
        with self._log.open("a") as log:
            self._process = host.start(
                *(str(_COMMAND), "run", "--no-ui", "--log-format", "json", "--status-every", "0.5", str(session)),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        self.pid = self._process.pid

    @property
    def log(self) -> list[dict[str, Any]]:
        """Every event and status line so far, oldest first; AssertionError for anything else (a traceback)."""
        whole, _, _ = self._log.read_bytes()[self._seen :].rpartition(b"\n")
        lines = whole.decode().splitlines()
        assert all(line.startswith("{") for line in lines), "\n".join(lines)
        return [json.loads(line) for line in lines]

    def said(self, words: str, since: float = 0.0) -> dict[str, Any] | None:
        """The first event since a moment (s since the epoch) with these words in it."""
        return next(
            (each for each in self.log if words in each.get("text", "") and each["time"] >= since),
            None,
        )

    def says(self, words: str, within: float = 10.0, since: float = 0.0) -> float:
        """Wait until it says so. Returns when it did, in s since the epoch."""
        when: float = eventually(lambda: self.said(words, since), within, f"{words!r}: {self._words()}")["time"]
        return when

    def status(self) -> dict[str, Any]:
        """The newest status line."""
        found = next((each["status"] for each in reversed(self.log) if "status" in each), None)
        return found or {"links": {}, "routes": []}

    def route(self, topic: str) -> dict[str, Any]:
        """What the newest status says of a topic; empty: nothing."""
        return next((each for each in self.status()["routes"] if each["topic"] == topic), {})

    def ledger(self, topic: str) -> Ledger:
        """A topic's ledger, which must balance."""
        route = self.route(topic)
        ledger = Ledger(**{field: route[field] for field in _LEDGER_FIELDS if field in route})
        assert balance(ledger) == ledger.offered, ledger
        return ledger

    @property
    def memory(self) -> int:
        """Resident bytes."""
        return int(Path(f"/proc/{self.pid}/statm").read_text().split()[1]) * 4096

    def kill(self) -> None:
        """As a power loss does: no goodbye, no clean-up."""
        self._process.kill()
        self._process.communicate()

    def close(self) -> None:
        """Stop it: in time, cleanly, without ever having failed inside."""
        if self._process.returncode is not None:
            return
        self._process.send_signal(signal.SIGTERM)
        code = self._process.communicate(timeout=_STOPS_WITHIN) and self._process.returncode
        assert code == 0, self._words()
        assert not self.said("internal error"), self._words()

    def _words(self) -> str:
        return "\n".join(f"{each['time']:.3f} {each['text']}" for each in self.log if "text" in each)


class Bridge(NamedTuple):
    """Two programs with a node beside each.

    Attributes:
        client: bridges the robot's domain.
        server: bridges the PC's.
        robot: talks and listens in the client's.
        pc: talks and listens in the server's.
    """

    client: Program
    server: Program
    robot: Node
    pc: Node

    def settled(self, *topics: str, within: float = 10.0) -> dict[str, Ledger]:
        """Wait until a robot's topics have nothing in flight, and as much delivered as the PC's node has heard.

        Returns:
            Their ledgers, which balance.
        """

        def ledgers() -> dict[str, Ledger]:
            return {topic: self.client.ledger(topic) for topic in topics}

        def done() -> bool:
            return all(
                not ledger.in_flight and ledger.delivered == len(self.pc.heard(topic))
                for topic, ledger in ledgers().items()
            )

        try:
            eventually(done, within)
        except AssertionError:
            heard = {topic: len(self.pc.heard(topic)) for topic in topics}
            raise AssertionError(f"not settled: {heard} heard, {ledgers()}") from None
        return ledgers()

    def close(self) -> None:
        """End all four."""
        for each in self:
            each.close()


class Sessions:
    """The session files of a bridge between two hosts.

    Attributes:
        client: the client's.
        server: the server's.
    """

    def __init__(self, folder: Path, address: str, *topics: dict[str, Any], domains: tuple[int, int]) -> None:
        write_key(folder / "robot1.key")
        self.domains = domains
        common = {"name": "robot1", "server_port": PORT, "key_file": "robot1.key"}
        told = [{"direction": "transmit", "type": "String", "qos": {"depth": 200}} | topic for topic in topics]
        client = {"role": "client", "server_ip": address, "domain_id": domains[0], "topics": told}
        anywhere = "::" if ":" in address else "0.0.0.0"  # noqa: S104 — of a host that only other hosts of ours reach
        server = {"role": "server", "server_ip": anywhere, "domain_id": domains[1]}
        self.client, self.server = folder / "client.yaml", folder / "server.yaml"
        self.client.write_text(yaml.safe_dump(common | client))
        self.server.write_text(yaml.safe_dump(common | server))

    def run(self, robot: Host, pc: Host) -> Bridge:
        """Start both programs, and nodes in their domains; linked when this returns."""
        server, client = Program(pc, self.server), Program(robot, self.client)
        bridge = Bridge(client, server, Node(robot, self.domains[0]), Node(pc, self.domains[1]))
        client.says("linked with", 20)
        return bridge
