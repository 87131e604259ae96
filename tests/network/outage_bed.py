"""A robot, a router and a server's machine, topics and calls between them, and what may happen to the path.

The router translates addresses where a fault needs that. `OutageBed.record` lets traffic flow until it is steady,
causes one fault, waits until traffic is steady again, and returns a `Record` with the bridge's own account.
"""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import yaml
from tests.network.bridging import PORT, Program
from tests.network.hosts import Cable, Host
from tests.network.traffic import SERVICE, Flow, Traffic
from tests.support.waiting import eventually

from rsb_bridge.config.keys import write_key

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path
    from types import TracebackType

NEAR, FAR = 80, 81
_ROBOT, _NEW_ROBOT, _AT_ROBOT = "10.99.1.2", "10.99.1.3", "10.99.1.1"
_ELSEWHERE, _AT_ELSEWHERE = "10.99.3.2", "10.99.3.1"
_OUTSIDE, _PC = "10.99.2.2", "10.99.2.1"
_OTHER_PC = "10.99.4.1"  # the same machine, to which a robot with two ways gets over its second device
FLOWS = (
    Flow("/up/reliable", "reliable", 10),
    Flow("/up/whole", "whole", 10),
    Flow("/up/kept", "kept", 10),
    Flow("/up/fast", "deep", 200),
    Flow("/up/latched", "latched"),
    Flow("/up/best", "best", 10),
    Flow("/down/reliable", "reliable", 10, to_robot=True),
    Flow("/down/latched", "latched", to_robot=True),
    Flow("/down/best", "best", 10, to_robot=True),
)
PLAIN = "plain"
TRANSPORTS = ("tcp", "udp", "zenoh", PLAIN)
_KEYS: dict[str, dict[str, Any]] = {
    "whole": {"qos": {"history": "keep_all"}},
    "kept": {"qos": 10, "keep": 60},
    "deep": {"qos": 1000},
}
"""Keys of the session's entry, by the flow's kind; other kinds have `qos: auto`."""
STEADY_BEFORE = 3.0
"""s of steady traffic before a fault."""
_READY_WITHIN = 60.0
_STEADY, _FRESH = 5.0, 1.0
"""Traffic is steady once, for `_STEADY` s, the newest message of each topic was younger than `_FRESH` s."""
_WATCHED_AFTER, _WATCHED_AFTER_KILL = 8.0, 24.0
"""s after a fault's end in which its effects may still come: a link without a byte is given up after 5 s, and DDS knows
after 20 s that a killed process has gone. A link moves back to a better way after 10 s."""
_BACK_WITHIN = 90.0
_DRAINS, _ACCOUNT_WITHIN = 3.0, 15.0
_IN_FLIGHT = 0.1
"""s before a fault at which a call is made: the server takes longer to answer."""


class Fault(NamedTuple):
    """Something that happens to the path.

    Attributes:
        kind: ``cut``, ``way``, ``reset``, ``address``, ``roam``, ``rebind``, or the side that is killed: ``server``,
            ``client``.
        seconds: how long it lasts, or 0 if it is a moment.
        translated: whether the router translates addresses.
        plain: whether nodes without a bridge have it, too.
    """

    words: str
    kind: str
    seconds: float = 0.0
    translated: bool = False
    plain: bool = False

    @property
    def two_ways(self) -> bool:
        """Whether the robot has two ways to the server."""
        return self.kind == "way"

    @property
    def ends_connections(self) -> bool:
        """Whether no connection outlives it, so that the bed can tell whether it has happened."""
        return self.kind != "cut" or self.translated


FAULTS = {
    **{f"cut-{long:g}": Fault(f"link down {long:g} s", "cut", long, plain=True) for long in (0.3, 1, 3, 6, 20, 60)},
    **{f"reset-{long:g}": Fault(f"every connection reset, for {long:g} s", "reset", long) for long in (0.3, 0.6)},
    "reset": Fault("every connection reset, once", "reset"),
    "forget-1": Fault("link down 1 s, the NAT forgets", "cut", 1, translated=True),
    "forget-3": Fault("link down 3 s, the NAT forgets", "cut", 3, translated=True),
    "address": Fault("the robot's address changes", "address", plain=True),
    "roam": Fault("the robot roams to another network", "roam", plain=True),
    "way": Fault("the better of two ways down 20 s", "way", 20),
    "rebind": Fault("the NAT rebinds", "rebind", translated=True),
    "server": Fault("server killed and started at once", "server"),
    "client": Fault("client killed and started at once", "client"),
}  # fmt: skip


@dataclass
class Record:
    """The messages published and heard around a fault. Times are ns of the monotonic clock.

    Attributes:
        began: when the fault began.
        ended: when its cause ended; for a moment the same.
        stopped: when the last message of a rate was published.
        steady: whether traffic came back before `stopped`.
        made: when each message was published, by topic; the first one's number is 1.
        heard: number, time of publication and time of arrival of each message that came.
        events: time, publishers that came and publishers that went in the listener's domain.
        calls: when each was made and answered, or 0, or `traffic.WRONG`; the first one's number is 1.
        offers: when the caller's domain got or lost the service, and which of the two.
        carried_out: the numbers of the calls that the server has had, in its order.
        accounts: the ledgers of the sending sides at the end, by topic; empty without our bridge.
    """

    began: int
    ended: int
    stopped: int = 0
    steady: bool = False
    made: dict[str, list[int]] = field(default_factory=dict)
    heard: dict[str, list[tuple[int, int, int]]] = field(default_factory=dict)
    events: dict[str, list[tuple[int, int, int]]] = field(default_factory=dict)
    calls: list[tuple[int, int]] = field(default_factory=list)
    offers: list[tuple[int, bool]] = field(default_factory=list)
    carried_out: list[int] = field(default_factory=list)
    accounts: dict[str, dict[str, Any]] = field(default_factory=dict)


class Side(Protocol):
    """One of the two ends of a bridge: our `Program`, or another bridge's."""

    def kill(self) -> None: ...

    def again(self) -> Self:
        """Start the same side again."""

    def close(self) -> None: ...


class OutageBed:
    """The machines with all that runs on them, which end with the context.

    Args:
        transport: of `TRANSPORTS`, or a name for what `other` makes. With ``plain`` there is no bridge, and all nodes
            are in one domain.
        other: makes the side of another bridge that listens on the server's machine in `FAR`, or that connects to it
            from the robot in `NEAR`, at an address and `PORT`.
        recordings: a folder for ``near.mcap`` and ``far.mcap``, what recorders in both domains have heard.
    """

    def __init__(
        self,
        folder: Path,
        transport: str,
        *,
        translated: bool = False,
        two_ways: bool = False,
        flows: Sequence[Flow] = FLOWS,
        other: Callable[[Host, str, str], Side] | None = None,
        recordings: Path | None = None,
    ) -> None:
        self._folder, self.transport, self._translated, self._flows = folder, transport, translated, flows
        self._two_ways, self._other, self._recordings = two_ways, other, recordings
        self._stack = ExitStack()
        self._sides: dict[str, Side] = {}

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._stack = stack
            self._join()
            hosts = {"server": self._pc, "client": self._robot}
            if self._other is not None:
                parts = {"server": "listen", "client": "connect"}
                self._sides = {name: self._other(host, parts[name], _PC) for name, host in hosts.items()}
            elif self.transport != PLAIN:
                self._write_sessions()
                self._sides = {name: Program(host, self._folder / f"{name}.yaml") for name, host in hosts.items()}
            stack.callback(self._end_sides)
            self._start_traffic()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:  # programs that an exception leaves in any state end with their hosts
            self._sides.clear()
        self._stack.__exit__(kind, error, trace)

    @property
    def programs(self) -> dict[str, Program]:
        """The two sides of our bridge, by their names, if it is ours."""
        return {name: each for name, each in self._sides.items() if isinstance(each, Program)}

    def _end_sides(self) -> None:
        for each in self._sides.values():  # as they are now: a killed one has a successor
            each.close()

    def _host(self, name: str) -> Host:
        host = Host(name)
        self._stack.callback(host.close)
        return host

    def _join(self) -> None:
        self._robot, self._router, self._pc = map(self._host, ("robot", "router", "pc"))
        self._router.run("sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward")
        Cable(self._robot, self._router).address((f"{_ROBOT}/24", f"{_AT_ROBOT}/24"))
        Cable(self._router, self._pc).address((f"{_OUTSIDE}/24", f"{_PC}/24"))
        # Without an address, or DDS would use both networks from the start.
        _, (_, elsewhere) = Cable(self._robot, self._router).ends
        self._router.address(elsewhere, f"{_AT_ELSEWHERE}/24")
        self._robot.run("ip", "link", "set", "eth1", "down")
        self._robot.route(_AT_ROBOT)
        if self._translated:
            self._router.nft("add table ip nat; add chain ip nat out { type nat hook postrouting priority 100; }")
            for protocol in ("tcp", "udp"):
                self._router.nft(f"add rule ip nat out oif eth1 meta l4proto {protocol} masquerade to :40000-40999")
        else:
            self._pc.route(_OUTSIDE)
        if self._two_ways:
            self._pc.address("eth0", f"{_OTHER_PC}/32")
            self._router.run("ip", "route", "add", _OTHER_PC, "via", _PC)
            self._robot.address("eth1", f"{_ELSEWHERE}/24")
            self._robot.run("ip", "link", "set", "eth1", "up")
            self._robot.run("ip", "route", "add", _OTHER_PC, "via", _AT_ELSEWHERE)

    def _write_sessions(self) -> None:
        write_key(self._folder / "robot1.key")
        topics = [
            {
                "topic": each.name,
                "direction": "receive" if each.to_robot else "transmit",
                "type": "std_msgs/msg/String",
                **_KEYS.get(each.kind, {}),
                **({"protocol": "udp"} if self.transport == "udp" else {}),
            }
            for each in self._flows
        ]
        listens: dict[str, Any] = {"server_ip": "0.0.0.0", "server_port": PORT}
        connects: dict[str, Any] = {"server_ip": _PC, "server_port": PORT}
        if self.transport == "zenoh":
            listens = {"server_ip": "zenoh", "zenoh": {"listen": [f"tcp/0.0.0.0:{PORT}"]}}
            connects = {"server_ip": "zenoh", "zenoh": {"connect": [f"tcp/{_PC}:{PORT}"]}}
        if self._two_ways:
            connects["server_ip"] = [_PC, _OTHER_PC]
        common = {"name": "robot1", "key_file": "robot1.key"}
        server = {"role": "server", "domain_id": FAR, **listens}
        client = {"role": "client", "domain_id": NEAR, **connects, "topics": topics}
        client["services"] = [{"service": SERVICE, "provider": "client"}]
        for session in (server, client):
            (self._folder / f"{session['role']}.yaml").write_text(yaml.safe_dump(common | session))

    def _start_traffic(self) -> None:
        up = [each for each in self._flows if not each.to_robot]
        down = [each for each in self._flows if each.to_robot]
        plain = self.transport == PLAIN
        for_robot: dict[str, Any] = {"domain_id": NEAR, "peer": _PC if plain else ""}
        for_pc: dict[str, Any] = {"domain_id": NEAR if plain else FAR, "peer": _ROBOT if plain else ""}
        self._listeners = (
            Traffic(self._pc, "listen", flows=up, calls=False, **for_pc),
            Traffic(self._robot, "listen", flows=down, calls=True, **for_robot),
        )
        self._talkers = (
            Traffic(self._robot, "talk", flows=up, calls=False, **for_robot),
            Traffic(self._pc, "talk", flows=down, calls=True, **for_pc),
        )
        self._caller = self._talkers[1]
        for each in (*self._talkers, *self._listeners):
            self._stack.callback(each.close)
        self._recorders = [
            self._recorder(host, about["domain_id"], name)
            for host, about, name in ((self._robot, for_robot, "near"), (self._pc, for_pc, "far"))
            if self._recordings is not None
        ]
        eventually(
            lambda: all(each.tell("matched") for each in (*self._talkers, *self._listeners)),
            _READY_WITHIN,
            "every node has found the others",
        )
        if self._other is None:  # zenoh-bridge-ros2dds may not bring a service of Fast DDS
            eventually(lambda: self._caller.tell("served"), _READY_WITHIN, "the caller has found the service")
        programs = self.programs
        for side, flows in (("server", up), ("client", down)):
            if side in programs:
                for flow in flows:
                    programs[side].sees_subscriber(flow.name)

    def _recorder(self, host: Host, domain: int, name: str) -> subprocess.Popen[str]:
        assert self._recordings is not None
        path = str(self._recordings / f"{name}.mcap")
        topics = (each.name for each in self._flows)
        process = host.start(sys.executable, "-m", "bench.recorder", str(domain), path, *topics, stdin=subprocess.PIPE)
        self._stack.callback(process.kill)
        return process

    def record(self, fault: Fault, before: float = STEADY_BEFORE) -> Record:
        """Cause a fault after `before` s of steady traffic, and wait until traffic is steady again.

        Raises:
            AssertionError: traffic never flowed, or connections have survived a fault that ends all of them.
        """
        for each in self._talkers:
            each.tell("go")
            for _ in range(3):
                each.tell("change")
        eventually(lambda: self._are_fresh(0), _READY_WITHIN, "every topic flows")
        time.sleep(before)
        self._change()
        time.sleep(_IN_FLIGHT)
        self._caller.tell("call")
        time.sleep(_IN_FLIGHT)
        connections = self._far_ends()
        assert bool(connections) == (self.transport != PLAIN), connections
        record = Record(*self._cause(fault))
        record.steady = self._is_steady(
            record.ended,
            _WATCHED_AFTER_KILL if fault.two_ways or fault.kind in {"server", "client"} else _WATCHED_AFTER,
        )
        if fault.ends_connections:
            assert not connections & self._far_ends(), f"connections have survived: {fault.words}"
        self._change()
        time.sleep(_FRESH)
        for each in self._talkers:
            each.tell("hush")
        record.stopped = time.monotonic_ns()
        time.sleep(_DRAINS)
        for each in self._talkers:
            record.made |= each.tell("made")
        for recorder in self._recorders:
            try:
                recorder.communicate(timeout=_ACCOUNT_WITHIN)
            except subprocess.TimeoutExpired:
                raise AssertionError("a recorder does not end") from None
            assert recorder.returncode == 0, "a recorder has failed"
        if self.programs:
            record.accounts = self._accounts()
        for each in self._listeners:
            record.heard |= each.tell("heard")
            record.events |= each.tell("events")
        record.calls = self._caller.tell("calls")
        record.offers = self._caller.tell("offers")
        record.carried_out = self._listeners[1].tell("carried out")
        return record

    def _change(self) -> None:
        """Publish on the latched topics."""
        for each in self._talkers:
            each.tell("change")

    # --- the faults

    def _cause(self, fault: Fault) -> tuple[int, int]:
        """Cause a fault, and return when it began and ended. Latched topics change in its middle, or right after it.

        A command takes up to 0.05 s. A fault that lasts begins and ends before its commands, and so it may seem to end
        a little early; a moment is before its command.
        """
        began = time.monotonic_ns()
        match fault.kind:
            case "cut":  # without a word, as out of a radio's reach
                lose = "chain inet fault every { type filter hook prerouting priority -500; policy drop; }"
                self._router.nft(f"add table inet fault; add {lose}")
            case "way":
                lose = "chain inet fault every { type filter hook prerouting priority -500; }"
                rules = (f"add rule inet fault every ip {end} {_ROBOT} drop" for end in ("saddr", "daddr"))
                self._router.nft("; ".join(("add table inet fault", f"add {lose}", *rules)))
            case "reset" if fault.seconds:
                reset = "chain inet fault every { type filter hook forward priority 0; }"
                rule = "rule inet fault every meta l4proto tcp reject with tcp reset"
                self._router.nft(f"add table inet fault; add {reset}; add {rule}")
            case "reset":  # the robot's kernel ends each connection, and tells the other side
                self._robot.run("ss", "--kill", "--tcp", "dst", _PC)
            case "address":
                device = f"ip address delete {_ROBOT}/24 dev eth0; ip address add {_NEW_ROBOT}/24 dev eth0"
                self._robot.run("sh", "-ec", f"{device}; ip route replace default via {_AT_ROBOT}")
            case "roam":
                device = f"ip link set eth0 down; ip address add {_ELSEWHERE}/24 dev eth1; ip link set eth1 up"
                self._robot.run("sh", "-ec", f"{device}; ip route replace default via {_AT_ELSEWHERE}")
            case "rebind":
                self._forget()
            case "server" | "client" as side:
                self._sides[side].kill()
                self._sides[side] = self._sides[side].again()
            case _:
                raise ValueError(fault.kind)
        if not fault.seconds:
            self._change()
            return began, began
        ends = began + int(fault.seconds * 1e9)
        time.sleep(fault.seconds / 2)
        self._change()
        time.sleep(max(0, ends - time.monotonic_ns()) / 1e9)
        if self._translated:
            self._forget()
        ended = time.monotonic_ns()
        self._router.nft("delete table inet fault")
        return began, ended

    def _forget(self) -> None:
        """Have the router forget its mappings, and make others; packets to the old ones reach nobody."""
        for protocol in ("tcp", "udp"):
            self._router.nft(f"insert rule ip nat out oif eth1 meta l4proto {protocol} masquerade to :41000-41999")
        self._router.run("conntrack", "--flush")

    def _far_ends(self) -> set[str]:
        """Return the addresses and ports from which TCP connections come, as the server's machine sees them."""
        found = self._pc.run("ss", "--tcp", "--numeric", "--no-header", "state", "established", "sport", f":{PORT}")
        return {line.split()[3] for line in found.splitlines()}

    # --- its end

    def _are_fresh(self, since: int) -> bool:
        """Whether each topic that has a rate has brought a young message that was published after `since`."""
        rated = {each.name for each in self._flows if each.rate}
        newest = [made for each in self._listeners for name, made in each.tell("newest").items() if name in rated]
        return bool(min(newest) > max(since, time.monotonic_ns() - int(_FRESH * 1e9)))

    def _is_steady(self, ended: int, watched: float) -> bool:
        """Wait until traffic is steady, at least `watched` s, at most `_BACK_WITHIN`. Return whether it is."""
        deadline = ended + int(_BACK_WITHIN * 1e9)
        steady_since = time.monotonic_ns()
        while (now := time.monotonic_ns()) < deadline:
            if not self._are_fresh(ended):
                steady_since = now
            elif now - steady_since > _STEADY * 1e9 and now - ended > watched * 1e9:
                return True
            time.sleep(0.2)
        return False

    def _accounts(self) -> dict[str, dict[str, Any]]:
        """Return the ledgers of the sending sides, once nothing is in flight or some time has passed."""
        programs = self.programs
        senders = {each.name: programs["server" if each.to_robot else "client"] for each in self._flows}
        asked, deadline = time.time(), time.monotonic() + _ACCOUNT_WITHIN
        while True:
            rows = {name: program.route(name) for name, program in senders.items()}
            if time.time() > asked + 2 and not any(row.get("waiting") or row.get("in_flight") for row in rows.values()):
                return rows  # a status is at most 1.5 s old
            if time.monotonic() > deadline:
                return rows
            time.sleep(0.5)
