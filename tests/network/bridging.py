"""`rsb-console run --no-ui` as it is installed, on two hosts, and what it says."""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from tests.network.node import Heard, Node
from tests.support.bridge import balance
from tests.support.waiting import eventually
from tests.support.wording import has_text

from rsb_bridge.config.keys import write_key
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Ledger

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tests.network.hosts import Host

    from rsb_bridge.model.wording import Wording

PORT = 49152
EACH_WAY = (
    {"topic": "/scan", "protocol": "udp"},
    {"topic": "/odom", "protocol": "tcp"},
    {"topic": "/cmd", "protocol": "udp", "direction": "receive"},
    {"topic": "/goal", "protocol": "tcp", "direction": "receive"},
)
"""Topics by either protocol, to the PC and to the robot."""
COMMAND = Path(sys.executable).with_name("rsb-console")
_STOPS_WITHIN = 20.0
_MEMORY = 256 << 20
"""Bytes: queues are bounded on any network (a program that bridges nothing has 65 MiB)."""
_LEDGER_FIELDS = (
    "offered", "delivered", "throttled", "expired", "waiting", "in_flight", "dropped", "unknown", "lost_in_dds",
)  # fmt: skip


class Program:
    """The program on a host; its log is read from a file.

    Attributes:
        control: its control socket, which every host reaches: they share their files.
    """

    def __init__(self, host: Host, session: Path) -> None:
        self._host = host
        self._session = session
        self._log = session.with_suffix(".log")
        self.control = session.with_suffix(".sock")
        self._seen = self._log.stat().st_size if self._log.exists() else 0
        with self._log.open("a") as log:
            self._process = host.start(
                *(str(COMMAND), "run", "--no-ui", "--log-format", "json", "--status-every", "0.5", str(session)),
                *("--control", str(self.control)),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    @property
    def log(self) -> list[dict[str, Any]]:
        """Every event and status line so far, oldest first; AssertionError for anything else (a traceback)."""
        whole, _, _ = self._log.read_bytes()[self._seen :].rpartition(b"\n")
        lines = whole.decode().splitlines()
        assert all(line.startswith("{") for line in lines), "\n".join(lines)
        return [json.loads(line) for line in lines]

    def happened(self, code: EventCode, about: str | Wording = "", since: float = 0.0) -> dict[str, Any] | None:
        """The first event of a kind since a moment (s since the epoch); with `about`, the first that `has_text`."""
        events = (each for each in self.log if each.get("code") == code and each["time"] >= since)
        return next((each for each in events if has_text(each["text"], about)), None)

    def happens(
        self, code: EventCode, about: str | Wording = "", *, within: float = 180.0, since: float = 0.0
    ) -> float:
        """Wait until it happens. Returns when it did, in s since the epoch."""
        try:
            when: float = eventually(lambda: self.happened(code, about, since), within)["time"]
        except AssertionError:
            raise AssertionError(f"no {code} {about!r} within {within:g} s, but:\n{self._words()}") from None
        return when

    def status(self) -> dict[str, Any]:
        """The newest status line."""
        found = next((each["status"] for each in reversed(self.log) if "status" in each), None)
        return found or {"links": {}, "routes": []}

    def links_since(self, moment: float) -> list[dict[str, Any]]:
        """Return the links of each status since a moment, s since the epoch."""
        return [link for status in self._statuses(moment) for link in status["links"].values()]

    def routes_since(self, moment: float) -> list[dict[str, Any]]:
        """Return the routes of each status since a moment, s since the epoch."""
        return [route for status in self._statuses(moment) for route in status["routes"]]

    def _statuses(self, since: float) -> list[dict[str, Any]]:
        return [each["status"] for each in self.log if "status" in each and each["time"] > since]

    def link(self) -> dict[str, Any]:
        """The link in the newest status, or an empty dict."""
        return next(iter(self.status()["links"].values()), {})

    def route(self, topic: str) -> dict[str, Any]:
        """Return a topic of the newest status, or an empty row."""
        return next((each for each in self.status()["routes"] if each["topic"] == topic), {})

    def sees_subscriber(self, topic: str) -> None:
        """Wait until its publisher of a topic has a subscriber."""
        eventually(
            lambda: "subscriber seen" not in self.route(topic).get("missing", ["subscriber seen"]),
            what=f"a subscriber of {topic}",
        )

    def ledger(self, topic: str) -> Ledger:
        """A topic's ledger, which must balance."""
        route = self.route(topic)
        ledger = Ledger(**{field: route[field] for field in _LEDGER_FIELDS if field in route})
        assert balance(ledger) == ledger.offered, ledger
        return ledger

    def kill(self) -> None:
        """End it as a power loss does: no goodbye, no clean-up."""
        self._process.kill()
        self._process.wait()

    def again(self) -> Program:
        """Start the same program again."""
        return Program(self._host, self._session)

    def close(self) -> None:
        """Stop it: in time, cleanly, without ever having failed inside."""
        if self._process.returncode is not None:
            return
        assert self._memory() < _MEMORY
        self._process.send_signal(signal.SIGTERM)
        assert self._process.wait(_STOPS_WITHIN) == 0, self._words()
        assert not self.happened(EventCode.ENGINE_ERROR), self._words()

    def _memory(self) -> int:
        return int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]) * resource.getpagesize()

    def _words(self) -> str:
        return "\n".join(f"{each['time']:.3f} {each['text']}" for each in self.log if "text" in each)


@dataclass
class Bridge:
    """Two programs, each with a node in its domain.

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

    def listen(self, *, pc: tuple[str, ...] = (), robot: tuple[str, ...] = ()) -> None:
        """Have the nodes listen, and wait until the bridge's publishers know them: earlier messages would be lost."""
        for node, side, topics in ((self.pc, self.server, pc), (self.robot, self.client, robot)):
            node.listen(*topics)
            for topic in topics:
                side.sees_subscriber(topic)

    def all_talk(self) -> None:
        """Have each topic of `EACH_WAY` talked on at 20 Hz and listened to; all flow when this returns."""
        self.listen(pc=("/scan", "/odom"), robot=("/cmd", "/goal"))
        for talker, topics in ((self.robot, ("/scan", "/odom")), (self.pc, ("/cmd", "/goal"))):
            for topic in topics:
                talker.talk(topic, rate=20)
        self.all_flow()

    def all_flow(self, within: float = 180.0) -> None:
        """Wait until something that is published from now on has come on each topic of `EACH_WAY`."""
        deadline, now = time.monotonic() + within, time.time()
        for listener, topic in ((self.pc, "/scan"), (self.pc, "/odom"), (self.robot, "/cmd"), (self.robot, "/goal")):
            listener.hears(topic, deadline - time.monotonic(), after=now)

    def settled(self, *topics: str, since: float = 0.0, within: float = 180.0) -> dict[str, Ledger]:
        """Wait until a robot's topics have nothing in flight, and as much delivered as the PC's node has heard.

        Args:
            since: s since the epoch; later messages are the present client's.
            within: s.

        Returns:
            Their ledgers, which balance.
        """

        def done() -> bool:
            return all(
                not ledger.open and ledger.delivered == len(self._heard_once(topic, since))
                for topic in topics
                for ledger in (self.client.ledger(topic),)
            )

        try:
            eventually(done, within)
        except AssertionError:
            found = {topic: (len(self._heard_once(topic, since)), self.client.ledger(topic)) for topic in topics}
            raise AssertionError(f"not settled; heard, and the ledger's: {found}") from None
        return {topic: self.client.ledger(topic) for topic in topics}

    def _heard_once(self, topic: str, since: float) -> list[Heard]:
        heard = [each for each in self.pc.heard(topic) if each.sent > since * 1e9]
        assert len({each.number for each in heard}) == len(heard), f"something came twice on {topic}"
        return heard

    def close(self) -> None:
        """End all four."""
        for each in (self.client, self.server, self.robot, self.pc):
            each.close()


class Sessions:
    """The session files of a bridge between two hosts.

    Attributes:
        client: the client's.
        server: the server's.
    """

    def __init__(
        self,
        folder: Path,
        address: str,
        *topics: dict[str, Any],
        services: tuple[dict[str, Any], ...] = (),
        domains: tuple[int, int],
        both: Mapping[str, Any] | None = None,
        zenoh: bool = False,
    ) -> None:
        """Write both files; `both` are further keys of each."""
        write_key(folder / "robot1.key")
        self.domains = domains
        common: dict[str, Any] = {"name": "robot1", "key_file": "robot1.key", **(both or {})}
        told = [{"direction": "transmit", "type": "String", "qos": {"depth": 200}} | topic for topic in topics]
        client: dict[str, Any] = {"role": "client", "server_ip": address, "domain_id": domains[0], "topics": told}
        if services:
            client["services"] = [{"provider": "server"} | service for service in services]
        anywhere = "::" if ":" in address else "0.0.0.0"
        server: dict[str, Any] = {"role": "server", "server_ip": anywhere, "domain_id": domains[1]}
        if zenoh:
            client |= {"server_ip": "zenoh", "zenoh": {"connect": [f"tcp/{address}:{PORT}"]}}
            server |= {"server_ip": "zenoh", "zenoh": {"listen": [f"tcp/{anywhere}:{PORT}"]}}
        else:
            common["server_port"] = PORT
        self.client, self.server = folder / "client.yaml", folder / "server.yaml"
        self.client.write_text(yaml.safe_dump(common | client))
        self.server.write_text(yaml.safe_dump(common | server))

    def run(self, robot: Host, pc: Host) -> Bridge:
        """Start both programs, and nodes in their domains."""
        server, client = Program(pc, self.server), Program(robot, self.client)
        return Bridge(client, server, Node(robot, self.domains[0]), Node(pc, self.domains[1]))
