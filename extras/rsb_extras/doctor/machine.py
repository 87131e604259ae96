"""Findings about a machine: Python, memory, network, clock, files and radio.

Nothing leaves the machine: the packets of the multicast test have a lifetime (TTL) of 0, and their group is the one
that hosts do not report to routers (RFC 3376, section 5). To join DDS's own sends a report.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import importlib.util
import json
import os
import platform
import pwd
import resource
import shutil
import socket
import struct
import subprocess
import sys
import time
from functools import partial
from importlib.metadata import version
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, TypeAlias

from rsb_bridge.feature_api import Check, Finding, Grade, Wording, join_first, state_folder, why_not_written
from rsb_bridge.installed_features import added, installed
from rsb_bridge.transport.descriptors import for_arrivals
from rsb_bridge.transport.network_news import open_news
from rsb_bridge.transport.tcp import BBR, congestion_control, prefer_bbr
from rsb_bridge.transport.transport import RECEIVE_BUFFER
from rsb_bridge.transport.udp import enlarge_buffers, granted_receive_buffer

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_MEGABYTE = 1 << 20
_LITTLE_SHARED_MEMORY = 64 * _MEGABYTE
"""As much as a container of Docker has in all, unless it is given more."""
_LITTLE_DISK = 100 * _MEGABYTE
"""A round figure: ten times what the files of events take at most (docs/budgets.md)."""
_FEW_DESCRIPTORS = 4096
"""A round figure: enough for some 1,300 TCP links, at three each."""
_NOT_SYNCHRONIZED = 5  # adjtimex: TIME_ERROR
_TIMEX = 208  # bytes of a struct timex on 64 bits, and more than on 32
_MAX_ERROR = struct.Struct("@Illl")  # modes, offset, freq, maxerror (µs)
_GROUP = "224.0.0.1"
_IFF_UP, _IFF_LOOPBACK, _IFF_MULTICAST = 0x1, 0x8, 0x1000
_SIOCGIFFLAGS = 0x8913
_ANSWERS_WITHIN = 2.0  # s
_LOCKED_WITHIN = 5.0
"""s until Fast DDS has locked a new file. Trying the lock earlier could steal it from a starting program."""
_Chain: TypeAlias = tuple[str, str, str]
"""Family, table and name."""
_NAMED = 5
"""Users in one finding."""


class MachineText(Wording):
    """Findings about a machine, and remedies."""

    BLUETOOTH_REMEDY = "for Bluetooth links, run it with the distribution's own Python (/usr/bin/python3)"
    EXTRAS_REMEDY = "pip install 'rsb-console[{missing}]'"
    SHARED_MEMORY = "{free} of {size} MB are free in {folder}"
    SHARED_MEMORY_LITTLE = "only {free} of {size} MB are free in {folder}: messages between nodes may get lost"
    SHARED_MEMORY_REMEDY = "make room, or in a container give more (docker run --shm-size=512m)"
    SEVERAL_USERS = (
        "Fast DDS's shared memory is used by several users ({users}): their nodes may see each other's topics, but get "
        "no message of them"
    )
    SEVERAL_USERS_REMEDY = (
        "start all nodes of this machine as one user, or set FASTDDS_BUILTIN_TRANSPORTS=UDPv4 for the others' nodes"
    )
    BUFFERS_SMALL = "only {given:,} bytes may wait in a UDP socket: large messages over UDP come late or get lost"
    BUFFERS_REMEDY = (
        "echo net.core.rmem_max={wanted} | sudo tee /etc/sysctl.d/60-rsb.conf && "
        "sudo sysctl -p /etc/sysctl.d/60-rsb.conf"
    )
    TCP_NO_BBR = "uses {used}, which takes each lost packet for a full link: on a radio link, BBR carries more"
    BBR_REMEDY = (
        "echo tcp_bbr | sudo tee /etc/modules-load.d/rsb.conf && sudo modprobe tcp_bbr && "
        "echo 'net.ipv4.tcp_allowed_congestion_control=reno cubic bbr' | sudo tee /etc/sysctl.d/61-rsb.conf && "
        "sudo sysctl -p /etc/sysctl.d/61-rsb.conf"
    )
    NETWORK_UNTOLD = (
        "the kernel tells nobody here when addresses and routes change ({error}): a link finds out by its silence"
    )
    NETWORK_REMEDY = "allow AF_NETLINK: RestrictAddressFamilies of systemd, or the seccomp rules of a container"
    CLOCK_NOT_SYNCHRONIZED = "not synchronized: figures that compare two machines' clocks in logs are off"
    CLOCK_REMEDY = "sudo timedatectl set-ntp true, or install chrony"
    NO_INTERFACE = "no network interface is up but loopback: only nodes of this machine discover each other"
    FIREWALL_REMEDY = (
        "open the bridge's port, and for ROS between machines the domain's UDP ports; "
        "sudo nft list ruleset shows the rules"
    )
    RULES_REMEDY = "sudo nft list ruleset shows them"
    FIREWALL_UNREADABLE = "only root may read the rules"
    NO_NFT = "the program nft is not installed, so the rules cannot be read"
    DESCRIPTORS_FEW = "only {limit:,} open files: three a TCP link; beyond {own:,} topics, messages cost more"
    DESCRIPTORS_REMEDY = "raise the hard limit: LimitNOFILE=65536 under systemd, ulimit -Hn in a shell"
    DISK = "{free:,} MB are free for the history and events in {folder}"


def checks(environ: Mapping[str, str], root: Path = Path("/")) -> tuple[Check, ...]:
    """Return the checks of a machine.

    Args:
        root: in place of ``/`` for ``/sys`` and ``/dev/shm``.
    """
    before = (Check("program", "program", _program), Check("extras", "extras", _extras))
    behind = (
        Check("shared_memory", "shared memory", partial(_shared_memory, root / "dev/shm")),
        Check("udp_buffers", "UDP buffers", _udp_buffers),
        Check("congestion_control", "TCP", _congestion_control),
        Check("network_news", "network", _network_news),
        Check("multicast", "multicast", _multicast),
        Check("firewall", "firewall", _firewall),
        Check("clock", "clock", _clock),
        Check("descriptors", "open files", _descriptors),
        Check("disk", "disk", partial(_disk, state_folder(environ))),
        Check("bluetooth", "Bluetooth", partial(_bluetooth, root)),
    )
    taken = [check.code for check in (*before, *behind)]
    return (*before, *added("checks", name_of=lambda check: check.code, taken=taken), *behind)


def _program() -> Iterator[Finding]:
    facts = {"version": version("rsb-console"), "python": platform.python_version(), "executable": sys.executable}
    system = f"{platform.system()} {platform.release()} {platform.machine()}"
    yield Finding(
        "program",
        Grade.OK,
        "program",
        f"rsb-console {facts['version']}, Python {facts['python']}, {system}",
        facts=facts | {"system": system},
    )


def _extras() -> Iterator[Finding]:
    wanted = {extra: module for feature in installed() for extra, module in feature.libraries.items()}
    found = {name: importlib.util.find_spec(module) is not None for name, module in wanted.items()}
    missing = [name for name, is_there in found.items() if not is_there]
    if missing:
        text, remedy = f"{' and '.join(missing)} not installed", MachineText.EXTRAS_REMEDY(missing=",".join(missing))
        yield Finding("extras", Grade.NOTE, "extras", text, remedy, found)
    else:
        yield Finding("extras", Grade.OK, "extras", f"{' and '.join(found)} installed", facts=found)


def _shared_memory(folder: Path) -> Iterator[Finding]:
    status = os.statvfs(folder)
    free, size = (status.f_frsize * blocks for blocks in (status.f_bavail, status.f_blocks))
    numbers = {"free": free // _MEGABYTE, "size": size // _MEGABYTE, "folder": folder}
    facts = {"free": free, "size": size}
    if free < _LITTLE_SHARED_MEMORY or not os.access(folder, os.W_OK):
        text, remedy = MachineText.SHARED_MEMORY_LITTLE(**numbers), MachineText.SHARED_MEMORY_REMEDY()
        yield Finding("shared_memory", Grade.WARNING, "shared memory", text, remedy, facts)
    else:
        yield Finding("shared_memory", Grade.OK, "shared memory", MachineText.SHARED_MEMORY(**numbers), facts=facts)
    locks = {path: _is_locked(path) for path in folder.glob("fast*_el") if "port" not in path.name}
    users = {os.geteuid(), *(owner for path, locked in locks.items() if locked and (owner := _owner(path)) is not None)}
    if len(users) > 1:
        names = sorted(map(_user_name, users))
        yield Finding(
            "shared_memory_users",
            Grade.WARNING,
            "shared memory",
            MachineText.SEVERAL_USERS(users=join_first(names, _NAMED)),
            MachineText.SEVERAL_USERS_REMEDY(),
            {"users": names},
        )
    left = [path for path, locked in locks.items() if locked is False]
    if left:
        segments = [path.with_name(path.name.removesuffix("_el")) for path in left]
        taken = sum(each.stat().st_size for each in segments if each.exists())
        yield Finding(
            "shared_memory_left",
            Grade.NOTE,
            "shared memory",
            f"killed programs have left {len(left)} files of Fast DDS ({taken // _MEGABYTE} MB) in {folder}",
            _cleaning(folder),
            {"files": len(left), "bytes": taken},
        )


def _cleaning(folder: Path) -> str:
    """Return how to remove what killed programs have left: Fast DDS's own tool spares the nodes that run."""
    beside = Path(sys.executable).with_name("fastdds")  # of the wheels, whose folder may be missing in $PATH
    if tool := "fastdds" if shutil.which("fastdds") else str(beside) if beside.exists() else "":
        return f"run: {tool} shm clean"
    return f"stop all ROS nodes of this machine, then run: rm {folder}/fast* {folder}/sem.fast*"


def _is_locked(path: Path) -> bool | None:
    """Whether the process runs that made a lock file of Fast DDS's, or None if that can't be found out."""
    try:
        with path.open() as lock:
            if time.time() - path.stat().st_ctime < _LOCKED_WITHIN:
                return None
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # it is gone, or not ours to read
        return None
    return False


def _owner(path: Path) -> int | None:
    try:
        return path.stat().st_uid
    except OSError:
        return None


def _user_name(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:  # of another container
        return str(number)


def _udp_buffers() -> Iterator[Finding]:
    """Ask for the buffer as the bridge does. net.core.rmem_max does not limit root, and containers may not show it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        enlarge_buffers(asking)
        given = granted_receive_buffer(asking)
    facts = {"given": given, "wanted": RECEIVE_BUFFER}
    if given < RECEIVE_BUFFER:
        text, remedy = MachineText.BUFFERS_SMALL(given=given), MachineText.BUFFERS_REMEDY(wanted=RECEIVE_BUFFER)
        yield Finding("udp_buffers", Grade.WARNING, "UDP buffers", text, remedy, facts)
    else:
        yield Finding("udp_buffers", Grade.OK, "UDP buffers", f"{given:,} bytes may wait in a UDP socket", facts=facts)


def _congestion_control() -> Iterator[Finding]:
    """Ask for it as the bridge does: which ones exist and are allowed differs by kernel, user and container."""
    with socket.socket() as asking:
        prefer_bbr(asking)
        used = congestion_control(asking)
    facts = {"used": used}
    if used == BBR:
        yield Finding("congestion_control", Grade.OK, "TCP", f"uses {used}", facts=facts)
    else:
        text, remedy = MachineText.TCP_NO_BBR(used=used), MachineText.BBR_REMEDY()
        yield Finding("congestion_control", Grade.NOTE, "TCP", text, remedy, facts)


def _network_news() -> Iterator[Finding]:
    """Listen as the bridge does: containers may refuse it."""
    finding = partial(Finding, "network_news", subject="network")
    try:
        open_news().close()
    except OSError as error:
        text = MachineText.NETWORK_UNTOLD(error=os.strerror(error.errno or 0))
        yield finding(grade=Grade.NOTE, text=text, remedy=MachineText.NETWORK_REMEDY())
    else:
        yield finding(grade=Grade.OK, text="the kernel tells when addresses and routes change")


def _clock() -> Iterator[Finding]:
    timex = ctypes.create_string_buffer(_TIMEX)
    library = ctypes.CDLL(None, use_errno=True)
    # Zeros ask, and change nothing.
    state = library.adjtimex(timex)
    if state < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    _, _, _, error = _MAX_ERROR.unpack_from(timex)
    facts = {"synchronized": state != _NOT_SYNCHRONIZED, "max_error": error / 1e6}
    if state == _NOT_SYNCHRONIZED:
        text, remedy = MachineText.CLOCK_NOT_SYNCHRONIZED(), MachineText.CLOCK_REMEDY()
        yield Finding("clock", Grade.WARNING, "clock", text, remedy, facts)
    else:
        yield Finding("clock", Grade.OK, "clock", f"synchronized, within {error / 1e3:.0f} ms", facts=facts)


def _multicast() -> Iterator[Finding]:
    names = [name for _, name in socket.if_nameindex() if _flags(name) & _IFF_UP]
    outward = [name for name in names if not _flags(name) & _IFF_LOOPBACK and _address(name)]
    works = {name: bool(_flags(name) & _IFF_MULTICAST) and comes_back(_address(name)) for name in outward}
    good, bad = ([name for name, comes in works.items() if comes == wanted] for wanted in (True, False))
    if not outward:
        yield Finding("multicast", Grade.NOTE, "multicast", MachineText.NO_INTERFACE(), facts=works)
    if good:
        yield Finding("multicast", Grade.OK, "multicast", f"works on {', '.join(good)}", facts=works)
    if bad:
        text = f"does not work on {', '.join(bad)}: nodes of other machines do not discover this one's there"
        remedy = f"sudo ip link set {bad[0]} multicast on; a bridge's own link needs none"
        yield Finding("multicast", Grade.WARNING, "multicast", text, remedy, works)


def _asked(name: str, request: int) -> bytes:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        return fcntl.ioctl(asking, request, struct.pack("256s", name.encode()[:15]))


def _flags(name: str) -> int:
    flags: int = struct.unpack_from("H", _asked(name, _SIOCGIFFLAGS), 16)[0]
    return flags


def _address(name: str) -> str:
    """Return an interface's IPv4 address, or an empty string."""
    try:
        return socket.inet_ntoa(_asked(name, 0x8915)[20:24])  # SIOCGIFADDR
    except OSError:
        return ""


def comes_back(address: str) -> bool:
    """Whether a datagram to the group comes back over an interface, without leaving the machine."""
    interface = socket.inet_aton(address)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiving,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending,
    ):
        try:
            receiving.bind(("", 0))
            receiving.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(_GROUP) + interface)
            receiving.settimeout(0.5)
            sending.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            sending.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
            sending.sendto(b"rsb-console doctor", (_GROUP, receiving.getsockname()[1]))
            receiving.recv(64)
        except OSError:
            return False
    return True


def _firewall() -> Iterator[Finding]:
    # Most users have no sbin in their PATH.
    program = shutil.which("nft") or shutil.which("nft", path="/usr/sbin:/sbin")
    if program is None or os.geteuid():
        text = MachineText.NO_NFT() if program is None else MachineText.FIREWALL_UNREADABLE()
        yield Finding("firewall", Grade.UNKNOWN, "firewall", text, MachineText.RULES_REMEDY())
        return
    try:
        listed = subprocess.run(  # noqa: S603 -- no shell; the program is nft
            [program, "-j", "list", "ruleset"], capture_output=True, text=True, timeout=_ANSWERS_WITHIN, check=True
        ).stdout
    except subprocess.SubprocessError as error:
        raise OSError(str(error)) from error
    chains = dropping_chains(json.loads(listed).get("nftables", []))
    facts = {"drops": bool(chains), "chains": chains}
    if chains:
        text, remedy = f"rules drop packets to this machine: {', '.join(chains)}", MachineText.FIREWALL_REMEDY()
        yield Finding("firewall", Grade.NOTE, "firewall", text, remedy, facts)
    else:
        yield Finding("firewall", Grade.OK, "firewall", "no rule drops packets to this machine", facts=facts)


def dropping_chains(listed: list[dict[str, Any]]) -> list[str]:
    """Return the chains that packets to this machine come through and that drop some: ``ip filter INPUT``.

    Docker's drops are in chains of the hook ``forward``, which such packets do not come through.
    """
    verdicts: dict[_Chain, set[str]] = {}
    reached: list[_Chain] = []
    for kind, each in (pair for entry in listed for pair in entry.items()):
        if kind == "chain":
            chain = (each["family"], each["table"], each["name"])
            verdicts.setdefault(chain, set()).add(each.get("policy", ""))
            if each.get("hook") == "input":
                reached.append(chain)
        elif kind == "rule":
            verdicts.setdefault((each["family"], each["table"], each["chain"]), set()).update(_verdicts(each["expr"]))
        elif kind == "map":  # its name stands with an @ where a rule looks a verdict up
            chain = (each["family"], each["table"], f"@{each['name']}")
            verdicts.setdefault(chain, set()).update(_verdicts(each.get("elem", [])))
    for family, table, name in reached:  # it grows
        targets = {(family, table, target) for target in verdicts[family, table, name]}
        reached += sorted(target for target in targets if target in verdicts and target not in reached)
    return [" ".join(chain) for chain in reached if verdicts[chain] & {"drop", "reject"}]


def _verdicts(expression: Any) -> Iterator[str]:
    """Yield the verdicts in an expression of nft's JSON, and the names of chains and maps that it leads to."""
    if isinstance(expression, list):
        for each in expression:
            yield from _verdicts(each)
    elif isinstance(expression, dict):
        for key, value in expression.items():
            if key in {"drop", "reject"}:
                yield key
            elif key in {"jump", "goto"}:
                yield value["target"]
            elif key == "xt" and isinstance(value, dict):  # of iptables
                yield str(value.get("name", "")).lower()
            else:
                yield from _verdicts(value)
    elif isinstance(expression, str) and expression.startswith("@"):
        yield expression


def _descriptors() -> Iterator[Finding]:
    # The program raises its soft limit to it.
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = hard if hard != resource.RLIM_INFINITY else 1 << 30
    if limit < _FEW_DESCRIPTORS:
        text, remedy = (
            MachineText.DESCRIPTORS_FEW(limit=limit, own=for_arrivals(limit)),
            MachineText.DESCRIPTORS_REMEDY(),
        )
        yield Finding("descriptors", Grade.WARNING, "open files", text, remedy, {"limit": limit})
    else:
        yield Finding("descriptors", Grade.OK, "open files", f"{limit:,} open files at most", facts={"limit": limit})


def _disk(folder: Path) -> Iterator[Finding]:
    existing = next(each for each in (folder, *folder.parents) if each.exists())
    free = shutil.disk_usage(existing).free
    facts = {"folder": str(folder), "free": free}
    megabytes = free // _MEGABYTE
    found = os.statvfs(existing)
    lacks = errno.EROFS if found.f_flag & os.ST_RDONLY else errno.ENOSPC if found.f_files and not found.f_favail else 0
    if lacks:
        text = why_not_written(OSError(lacks, os.strerror(lacks)), existing)
        yield Finding("disk", Grade.WARNING, "disk", text, facts=facts)
    elif not os.access(existing, os.W_OK):
        text = f"{existing} is not writable: there will be no history after a restart"
        # Not the nearest folder that exists, which may be /: the remedy gives the folder to the user.
        remedy = f"sudo install -d -m 700 -o $(id -un) {quote(str(folder))}  # or set XDG_STATE_HOME to another folder"
        yield Finding("disk", Grade.WARNING, "disk", text, remedy, facts)
    elif free < _LITTLE_DISK:
        text = f"only {megabytes:,} MB are free for the history and events in {folder}"
        yield Finding("disk", Grade.WARNING, "disk", text, "make room, or set XDG_STATE_HOME to another folder", facts)
    else:
        yield Finding("disk", Grade.OK, "disk", MachineText.DISK(free=megabytes, folder=folder), facts=facts)


def bluetooth_adapters(root: Path = Path("/")) -> list[str]:
    """Return the names of this machine's Bluetooth adapters: ``hci0``."""
    folder = root / "sys/class/bluetooth"
    return sorted(path.name for path in folder.iterdir() if ":" not in path.name) if folder.is_dir() else []


def _bluetooth(root: Path) -> Iterator[Finding]:
    if not hasattr(socket, "AF_BLUETOOTH"):
        text, remedy = "this Python has no Bluetooth sockets", MachineText.BLUETOOTH_REMEDY()
        yield Finding("bluetooth", Grade.NOTE, "Bluetooth", text, remedy, {"sockets": False})
        return
    names = bluetooth_adapters(root)
    text = f"adapters {', '.join(names)}" if names else "no adapter: links over Bluetooth need one"
    yield Finding(
        "bluetooth", Grade.OK if names else Grade.NOTE, "Bluetooth", text, facts={"sockets": True, "adapters": names}
    )
