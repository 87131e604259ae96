"""Findings about what a session needs of this machine: its ports, keys, types and optional packages."""

from __future__ import annotations

import contextlib
import errno
import itertools
import json
import os
import shutil
import socket
import subprocess
import sys
import time
from functools import cache, partial
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.advice import advise, guarded_here_alone, missing_transports, uninstalled_types
from rsb_bridge.config.keys import KeyFileError, key_warnings, session_keys
from rsb_bridge.config.validation import domain_of
from rsb_bridge.feature_api import Check, Finding, Grade, RemoteEngine, Wording, other_side, running_bridges
from rsb_bridge.model import transports
from rsb_bridge.model.verdict import clocks_differ
from rsb_bridge.transport import multipath
from rsb_bridge.transport.descriptors import first_open_port
from rsb_bridge.transport.listening import EVERY_ADDRESS
from rsb_bridge.transport.network_news import addresses
from rsb_console.notation.formats import span
from rsb_extras.doctor.machine import MachineText, bluetooth_adapters

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from rsb_bridge.config.keys import Key
    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.feature_api import Session, Snapshot

_BASE_TIMEOUTS = (sys.executable, "-P", "-m", "rsb_bridge.ros.base_timeouts")
"""-P: no module of the working folder runs."""
_ASKED_FOR = 30.0
"""s. To find the nodes takes 3 s, and each node that does not answer 4 s at most (`ros.base_timeouts`)."""


_LONGEST_RETRY, _MOST_RETRY = 120.0, 2.0
"""s between retransmissions: the longest of kernels without a setting, and what an operator would hardly notice."""


class NeedText(Wording):
    """Findings about a session's needs, and remedies."""

    PORT_OWN = "this session's bridge runs, and has port {port} (pid {pid})"
    PORT_PRIVILEGED = "port {port} is refused: those below {limit} need root or CAP_NET_BIND_SERVICE"
    NAME = "port {port} was not tried: {address} is a name, and to look it up could ask the network"
    NO_BLUETOOTH_SOCKETS = "the session uses Bluetooth, and this Python has no Bluetooth sockets"
    ADAPTER_REMEDY = "plug one in, or load its driver: rfkill list, and sudo dmesg | grep -i bluetooth"
    BASE_GOES_ON = "{node} has no parameter that stops it when {topic} is silent: it may go on if this bridge is killed"
    BASE_REMEDY = "give the base a timeout, such as cmd_vel_timeout: 0.5, and try it with the wheels off the ground"
    BASE_SILENT = "{node}, which {topic} drives, does not tell its parameters: try whether it stops by itself"
    BASE_ABSENT = "no node subscribes to {topic} in domain {domain}: start the base to learn whether it stops by itself"
    BASE_NOT_ASKED = "what {topics} drives could not be asked whether it stops by itself"
    NO_MULTIPATH = "the kernel has no Multipath TCP ({error}): streams use one way"
    MULTIPATH_REMEDY = "sudo sysctl -w net.mptcp.enabled=1; it is in kernels since Linux 5.6 that are built with it"
    ONE_WAY = "no address is named as a second way (ip mptcp endpoint show is empty): streams use one way"
    SECOND_WAY_REMEDY = (
        "sudo ip mptcp limits set subflows 2 add_addr_accepted 2; sudo ip mptcp endpoint add {address} dev {device} "
        "subflow backup; and, with the gateway there, sudo ip route add default via GATEWAY dev {device} table 42; "
        "sudo ip rule add from {address} table 42"
    )
    WAYS = "streams may use further ways from {addresses}"
    SLOW_RETURN = "after a cut, the kernel may wait for {seconds:.0f} s until it uses the usual way again"
    SLOW_RETURN_REMEDY = "sudo sysctl -w net.ipv4.tcp_rto_max_ms=1000 (Linux 6.15 has it)"
    CLOCKS_AGREE = "the clock of {peer} differs from this machine's by {span}"


def checks(
    session: Session,
    path: Path,
    environ: Mapping[str, str],
    root: Path = Path("/"),
    base_timeouts: Sequence[str] = _BASE_TIMEOUTS,
) -> tuple[Check, ...]:
    """Return the checks of what a session needs.

    Args:
        root: in place of ``/`` for ``/sys``.
        base_timeouts: command that prints what `rsb_bridge.ros.base_timeouts` prints.
    """
    running = cache(partial(_running, path, environ))  # three checks ask it
    return (
        Check("ports", "ports", partial(_ports, session, path, environ)),
        Check("keys", "keys", partial(_keys, session, path)),
        Check("session", "session", partial(_transports, session, root)),
        Check("session", "session", partial(_advice, session, environ)),
        Check("ros_domain", "ROS domain", partial(_domain, session, running, environ)),
        Check("clock", "clock", partial(_peers_clocks, running)),
        Check("multipath", "multipath", partial(_multipath, session, root)),
        Check("base", "base", partial(_base, session, running, environ, base_timeouts)),
    )


def _multipath(session: Session, root: Path) -> Iterator[Finding]:
    """Find out what `multipath` lacks here. The kernel's list of ways is a client's; a server needs none."""
    if not session.multipath:
        return
    finding = partial(Finding, "multipath", subject="multipath")
    if reason := multipath.problem():
        text = NeedText.NO_MULTIPATH(error=reason)
        yield finding(grade=Grade.WARNING, text=text, remedy=NeedText.MULTIPATH_REMEDY())
        return
    if session.role == "client":
        further = _further_ways()
        if further is None:
            yield finding(grade=Grade.UNKNOWN, text="ip mptcp endpoint show does not work: is iproute2 installed?")
        elif further:
            text = NeedText.WAYS(addresses=", ".join(further))
            yield finding(grade=Grade.OK, text=text, facts={"addresses": further})
        else:
            device, address = next(iter(_other_addresses(session.host)), ("DEVICE", "ADDRESS"))
            remedy = NeedText.SECOND_WAY_REMEDY(device=device, address=address)
            yield finding(grade=Grade.WARNING, text=NeedText.ONE_WAY(), remedy=remedy)
    else:
        yield finding(grade=Grade.OK, text="the kernel has Multipath TCP")
    try:
        longest = int((root / "proc/sys/net/ipv4/tcp_rto_max_ms").read_text()) / 1000
    except (OSError, ValueError):
        longest = _LONGEST_RETRY
    if longest > _MOST_RETRY:
        text = NeedText.SLOW_RETURN(seconds=longest)
        yield finding(grade=Grade.NOTE, text=text, remedy=NeedText.SLOW_RETURN_REMEDY(), facts={"seconds": longest})


def _further_ways() -> list[str] | None:
    """Return the addresses from which the kernel opens further subflows, or None if that is unknown."""
    program = shutil.which("ip") or shutil.which("ip", path="/usr/sbin:/sbin")
    if program is None:
        return None
    try:
        ran = subprocess.run(  # noqa: S603 -- no shell; the program is ip
            [program, "mptcp", "endpoint", "show"], capture_output=True, text=True, timeout=2.0, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    rows = [line.split() for line in ran.stdout.splitlines()]
    return [row[0] for row in rows if "subflow" in row or "fullmesh" in row]


def _other_addresses(server: str) -> Iterator[tuple[str, str]]:
    """Yield devices and addresses of this machine from which no connection to the server leaves by itself."""
    family = socket.AF_INET6 if ":" in server else socket.AF_INET
    usual = ""
    with socket.socket(family, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        if _is_address(server):  # else a name server would be asked
            probe.connect((server, 9))  # which sends nothing
            usual = probe.getsockname()[0]
    for device, address in addresses():
        if (":" in address) == (":" in server) and address != usual:
            found = ip_address(address)
            if not (found.is_loopback or found.is_link_local):
                yield device, address


def _base(
    session: Session, running: Callable[[], Snapshot | None], environ: Mapping[str, str], command: Sequence[str]
) -> Iterator[Finding]:
    """Find out whether what this bridge lets move stops by itself: the bridge cannot stop it if it is killed."""
    names = tuple(dict.fromkeys(guarded_here_alone(session)))
    if not names:
        return
    finding = partial(Finding, "base", subject="base")
    try:
        bridge = running()
        domain = domain_of(session, environ.get("ROS_DOMAIN_ID")) if bridge is None else bridge.domain_id
        ran = subprocess.run(  # noqa: S603 -- own program
            [*command, str(domain), *names], capture_output=True, text=True, timeout=_ASKED_FOR, check=True
        )
        # The last line only: Fast DDS writes its faults to standard output, too.
        said: dict[str, dict[str, dict[str, float] | None]] = json.loads(ran.stdout.splitlines()[-1])
    except (subprocess.SubprocessError, ValueError, IndexError):
        yield finding(grade=Grade.UNKNOWN, text=NeedText.BASE_NOT_ASKED(topics=", ".join(names)))
        return
    for topic, nodes in said.items():
        if not nodes:
            yield finding(grade=Grade.UNKNOWN, text=NeedText.BASE_ABSENT(topic=topic, domain=domain))
        for node, timeouts in nodes.items():
            facts = {"topic": topic, "node": node, "timeouts": timeouts}
            on = {name: value for name, value in (timeouts or {}).items() if value and value > 0}
            if timeouts is None:
                yield finding(grade=Grade.UNKNOWN, text=NeedText.BASE_SILENT(topic=topic, node=node), facts=facts)
            elif on:
                named = ", ".join(f"{name}: {value:g}" for name, value in on.items())
                text = f"{node} stops by itself when {topic} is silent ({named})"
                yield finding(grade=Grade.OK, text=text, facts=facts)
            else:
                text, remedy = NeedText.BASE_GOES_ON(topic=topic, node=node), NeedText.BASE_REMEDY()
                yield finding(grade=Grade.WARNING, text=text, remedy=remedy, facts=facts)


def _running(path: Path, environ: Mapping[str, str]) -> Snapshot | None:
    """Return what the bridge that runs this session file shows, or None if none does."""
    bridge = _own_bridge(path, environ)
    if bridge is None:
        return None
    engine = RemoteEngine(bridge.path, read_only=True)
    engine.start()
    with engine:
        return engine.snapshot()


def _domain(session: Session, running: Callable[[], Snapshot | None], environ: Mapping[str, str]) -> Iterator[Finding]:
    """Tell of a bridge in another domain than this shell: a service has the domain of its own environment."""
    bridge, here = running(), environ.get("ROS_DOMAIN_ID")
    if bridge is not None and (domain := domain_of(session, here)) != bridge.domain_id:
        text = f"this session's bridge runs in domain {bridge.domain_id}, and this shell is in domain {domain}"
        remedy = f"look at its topics with ROS_DOMAIN_ID={bridge.domain_id}; set domain_id if that is the wrong one"
        yield Finding("ros_domain", Grade.WARNING, "ROS domain", text, remedy, {"running": bridge.domain_id})


def _peers_clocks(running: Callable[[], Snapshot | None]) -> Iterator[Finding]:
    """Compare this machine's clock with the peers', as the session's bridge has measured them if it runs."""
    bridge = running()
    if bridge is None:
        return
    for link in bridge.links:
        if link.clock_offset is None:
            continue
        peer = other_side(bridge.role, link.name)
        facts = {"link": link.name, "offset": link.clock_offset, "uncertainty": link.clock_uncertainty}
        finding = partial(Finding, "clock", subject="clock", facts=facts)
        if warning := clocks_differ(peer, link.clock_offset, link.clock_uncertainty):
            yield finding(grade=Grade.WARNING, text=warning)
        else:
            yield finding(grade=Grade.OK, text=NeedText.CLOCKS_AGREE(peer=peer, span=span(abs(link.clock_offset))))


def _ports(session: Session, path: Path, environ: Mapping[str, str]) -> Iterator[Finding]:
    if session.role != "server" or not transports.of_link(session.host).ip_ports:
        return
    port, address = session.server_port, session.host
    finding = partial(Finding, "ports", subject="ports", facts={"port": port, "address": address})
    if not _is_address(address):
        yield finding(grade=Grade.UNKNOWN, text=NeedText.NAME(port=port, address=address))
        return
    taken: dict[str, None] = {}
    addresses = (address, "0.0.0.0") if address == EVERY_ADDRESS else (address,)  # noqa: S104
    kinds = (("TCP", socket.SOCK_STREAM), ("UDP", socket.SOCK_DGRAM))
    for each, (name, kind) in itertools.product(addresses, kinds):
        family = socket.AF_INET6 if ":" in each else socket.AF_INET
        with socket.socket(family, kind) as tried:
            if family == socket.AF_INET6:
                tried.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)  # as the bridge
            if kind == socket.SOCK_STREAM:
                tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # connections that just ended do not count
            try:
                tried.bind((each, port))
            except OSError as error:
                if error.errno == errno.EADDRNOTAVAIL:
                    text = f"this machine has no address {each}"
                    yield finding(
                        grade=Grade.ERROR,
                        text=text,
                        remedy="correct server_ip, or use 0.0.0.0; role: client, if the server is another machine",
                    )
                    return
                if error.errno == errno.EACCES:
                    text = NeedText.PORT_PRIVILEGED(port=port, limit=first_open_port())
                    yield finding(grade=Grade.ERROR, text=text, remedy="set a higher server_port, on both sides")
                    return
                if error.errno != errno.EADDRINUSE:
                    reason = os.strerror(error.errno or 0)
                    yield finding(grade=Grade.ERROR, text=f"port {port} is refused: {reason}")
                    return
                taken[name] = None
    if taken and (bridge := _own_bridge(path, environ)) is not None:
        yield finding(grade=Grade.OK, text=NeedText.PORT_OWN(port=port, pid=bridge.pid))
    elif taken:
        text = f"port {port} is taken ({', '.join(taken)}): another program has it"
        yield finding(grade=Grade.WARNING, text=text, remedy=f"ss -lntup 'sport = :{port}' shows the program")
    else:
        yield finding(grade=Grade.OK, text=f"port {port} is free for TCP and UDP")


def _is_address(host: str) -> bool:
    """Whether a host is an IP address, or the name that every machine knows."""
    try:
        ip_address(host)
    except ValueError:
        return host == "localhost"
    return True


def _own_bridge(path: Path, environ: Mapping[str, str]) -> RunningBridge | None:
    """Return the bridge that runs this session file on this machine."""
    return next((bridge for bridge in running_bridges(environ) if bridge.runs(path)), None)


def _keys(session: Session, path: Path) -> Iterator[Finding]:
    finding = partial(Finding, "keys", subject="keys")
    found = dict(session_keys(session, path.parent))
    if not found:
        yield finding(grade=Grade.OK, text="the session uses no key")
        return
    read: dict[str, tuple[Key, ...]] = {}
    for name, key in found.items():
        if isinstance(key, KeyFileError):
            yield finding(grade=Grade.ERROR, text=str(key))
        else:
            read[name] = (key,)
    warnings = list(key_warnings(read, time.time()))
    for warning in warnings:
        yield finding(grade=Grade.WARNING, text=warning)
    if read and not warnings:
        yield finding(grade=Grade.OK, text=f"{', '.join(read)} have safe modes")


def _transports(session: Session, root: Path) -> Iterator[Finding]:
    """Find what this machine lacks: without it no link comes up, or no topic over Bluetooth opens."""
    lacks = partial(Finding, "session", Grade.ERROR, "session")
    if session.adapter is not None:
        facts = {"lacks": "bluetooth"}
        if not hasattr(socket, "AF_BLUETOOTH"):
            yield lacks(NeedText.NO_BLUETOOTH_SOCKETS(), MachineText.BLUETOOTH_REMEDY(), facts)
        elif not bluetooth_adapters(root):
            yield lacks("the session uses Bluetooth, and this machine has no adapter", NeedText.ADAPTER_REMEDY(), facts)
    transport = transports.of_link(session.host)
    if missing := transport.missing():
        text, _, remedy = missing.partition(": ")
        yield lacks(text, remedy, {"lacks": transport.name})


def _advice(session: Session, environ: Mapping[str, str]) -> Iterator[Finding]:
    errors = set(missing_transports(session))  # findings of `_transports`
    for problem in advise(session, environ.get("ROS_DOMAIN_ID")):
        if problem not in errors:
            yield Finding("session", Grade.WARNING, "session", str(problem))
    for problem in uninstalled_types(session):
        yield Finding("types", Grade.NOTE, "types", str(problem))
