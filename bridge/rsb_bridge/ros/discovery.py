"""Discovery of nodes by DDS, as the environment sets it: discovery servers of Fast DDS, or a range that is off.

A client of a discovery server learns only of the nodes that share a topic with it. So a bridge would wait for ever for
publishers of the topics to which it does not subscribe yet: it has to be a super client, which learns of all.

Whether a server answers is found out with a question of our own (RTPS 2.2, 8.3 and 9.4), as rmw does not say: a
participant without endpoints announces itself (SPDP), with the properties that Fast DDS demands of a client, and leaves
at once.
"""

from __future__ import annotations

import re
import secrets
import socket
import struct
from contextlib import closing
from typing import TYPE_CHECKING, Final, NamedTuple

from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.environment import with_variables
from rsb_bridge.ros.memory import PROFILE_VARIABLES, profile_variable

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, MutableMapping
    from contextlib import AbstractContextManager

SERVERS, SUPER_CLIENT, RANGE = "ROS_DISCOVERY_SERVER", "ROS_SUPER_CLIENT", "ROS_AUTOMATIC_DISCOVERY_RANGE"
_FAST_DDS = "rmw_fastrtps"
_SERVER = re.compile(
    r"(?:(?P<transport>UDP|TCP)v(?P<version>[46]):)?(?:\[(?P<inside>[^\]]+)\]|(?P<host>[^:\[\]]+))(?::(?P<port>\d+))?"
)
_PORTS = {"UDP": 11811, "TCP": 42100}
ANSWERS_WITHIN = 1.0
"""s. A round figure: a server on this machine answers within 1 ms, and one beyond a satellite within 0.7 s."""
_ASKED_AGAIN = 0.3  # s: a datagram may be lost

# RTPS.
_HEAD: Final = b"RTPS\x02\x02\x01\x0f"  # version 2.2, and the vendor whose parameters follow
_DATA, _ENDIAN, _HAS_INLINE_QOS, _HAS_PAYLOAD = 0x15, 1, 2, 4
_PARTICIPANT, _WRITER, _READER = b"\x00\x00\x01\xc1", b"\x00\x01\x00\xc2", b"\x00\x01\x00\xc7"
_SENTINEL, _LEASE, _VERSION, _VENDOR, _DATA_LOCATOR, _LOCATOR, _GUID = 0x01, 0x02, 0x15, 0x16, 0x31, 0x32, 0x50
_ENDPOINTS, _PROPERTIES, _KEY_HASH, _STATUS, _IDENTITY, _IDENTITY_2 = 0x58, 0x59, 0x70, 0x71, 0x83, 0x800F
_LEAVES = b"\x00\x00\x00\x03"
_BEFORE_NUMBER, _AFTER_NUMBER = b"DS", b"_EPROSIMA"  # of the server's id, with a byte between them
_PREFIX_AT, _LONGEST = len(_HEAD), 2048
_LEAVES_BY_ITSELF = 3  # s, if the last datagram is lost


class DiscoveryText(Wording):
    """Texts about discovery, for operators."""

    SUPER_CLIENT = "DDS finds nodes by the {servers}: {variable} is set here, so that the bridge sees all nodes"
    OFF = "{variable}=OFF hides all nodes: unset it"
    ANSWERS = "{server} answers"
    SILENT = "{server} does not answer: start it, or correct {variable}"
    UNRESOLVED = "{server} has no address ({reason}): correct {variable}"
    OTHER_NUMBER = "{server} has the id {number}, which is not its place in {variable} ({place}): correct it"
    UNREADABLE = "{variable} has {entry!r}, which is no address"


class DiscoveryServer(NamedTuple):
    """An entry of `SERVERS`.

    Attributes:
        place: its place in the list, from 0, which Fast DDS 2 takes for the server's id.
        transport: ``UDP`` or ``TCP``.
        version: of the IP, ``4`` or ``6``, or empty: then it is as the host has it.
    """

    place: int
    transport: str
    version: str
    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"discovery server {host}:{self.port}"

    def problem(self, *, by_id: bool = True) -> str:
        """Ask it; return the reason why it finds no nodes, or an empty string. Takes up to 1 s, or as names take.

        Args:
            by_id: whether clients hear no server that has another id.
        """
        family = {"4": socket.AF_INET, "6": socket.AF_INET6}.get(self.version, socket.AF_UNSPEC)
        kind = socket.SOCK_STREAM if self.transport == "TCP" else socket.SOCK_DGRAM
        try:
            (family, _, _, _, address), *_ = socket.getaddrinfo(self.host, self.port, family, kind)
        except OSError as error:
            return DiscoveryText.UNRESOLVED(server=self, reason=error.strerror, variable=SERVERS)
        try:
            with closing(socket.socket(family, kind)) as asking:
                asking.settimeout(ANSWERS_WITHIN)
                asking.connect(address)
                number = self.place if kind is socket.SOCK_STREAM else _asked(asking)
        except OSError:  # refused, or nothing came
            return DiscoveryText.SILENT(server=self, variable=SERVERS)
        if by_id and number not in {self.place, None}:
            return DiscoveryText.OTHER_NUMBER(server=self, number=number, place=self.place, variable=SERVERS)
        return ""


class Discovery:
    """Discovery in this process's environment, and whether it works.

    Attributes:
        servers: the discovery servers, of Fast DDS only.
        found: what keeps nodes from being found, or how the servers are; may be empty.
        is_broken: whether `found` is a problem.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._by_id = profile_variable(environment) == PROFILE_VARIABLES[0]
        wanted = environment.get("RMW_IMPLEMENTATION", "")
        self.servers, problem = (
            discovery_servers(environment) if wanted.startswith(_FAST_DDS) or not wanted else ((), "")
        )
        self._problem = DiscoveryText.OFF(variable=RANGE) if is_off(environment) else problem
        self.found, self.is_broken = self._problem, bool(self._problem)

    def notes(self) -> Iterator[tuple[Level, str]]:
        """Yield what operators should know of it at the start."""
        if self.servers:
            servers = " and the ".join(map(str, self.servers))
            yield Level.INFO, DiscoveryText.SUPER_CLIENT(servers=servers, variable=SUPER_CLIENT)
        if self._problem:
            yield Level.WARNING, self._problem

    def problems(self) -> dict[DiscoveryServer, str]:
        """Ask each server, see `DiscoveryServer.problem`."""
        return {each: each.problem(by_id=self._by_id) for each in self.servers}

    def look(self) -> bool:
        """Ask the servers; return whether `found` has changed. Slow: not for the I/O thread."""
        before = self.found
        if self.servers and not self._problem:
            problems = self.problems()
            # Several servers are for redundancy: one that answers is enough.
            self.is_broken = all(problems.values())
            told = (problem or DiscoveryText.ANSWERS(server=server) for server, problem in problems.items())
            self.found = "; ".join(told)
        return self.found != before


def discovery_servers(environment: Mapping[str, str]) -> tuple[tuple[DiscoveryServer, ...], str]:
    """Return the servers that the environment lists, and what is wrong with the list, or an empty string."""
    servers = []
    for place, entry in enumerate(environment.get(SERVERS, "").split(";")):
        if not (text := entry.strip()):
            continue  # which leaves the place to no server
        if (found := _SERVER.fullmatch(text)) is None or int(found["port"] or 0) > 0xFFFF:
            return (), DiscoveryText.UNREADABLE(variable=SERVERS, entry=text)
        transport = found["transport"] or "UDP"
        port = int(found["port"] or _PORTS[transport])
        servers.append(
            DiscoveryServer(place, transport, found["version"] or "", found["inside"] or found["host"], port)
        )
    return tuple(servers), ""


def is_off(environment: Mapping[str, str]) -> bool:
    """Whether DDS is to find no nodes, by server or without."""
    return environment.get(RANGE, "").upper() == "OFF" and environment.get("ROS_LOCALHOST_ONLY", "0") != "1"


def whole_graph(environment: MutableMapping[str, str]) -> AbstractContextManager[None]:
    """Have the participant that the context creates learn of all nodes from a discovery server.

    Setup files of robots export `SUPER_CLIENT` as false for processes without a terminal, so its value is ignored.
    """
    return with_variables(environment, {SUPER_CLIENT: "TRUE"})


# --- the question to a server


def _asked(asking: socket.socket) -> int | None:
    """Announce a participant to a server; return the server's id, or None if its answer has none.

    Args:
        asking: connected to the server, so that the kernel reports if nothing listens there.

    Raises:
        OSError: no answer.
    """
    prefix = _HEAD[-2:] + secrets.token_bytes(10)
    with closing(socket.socket(asking.family, socket.SOCK_DGRAM)) as answered:
        answered.bind((asking.getsockname()[0], 0))
        answered.settimeout(_ASKED_AGAIN)
        for _ in range(round(ANSWERS_WITHIN / _ASKED_AGAIN)):
            asking.send(_announcement(prefix, answered))
            try:
                answer = answered.recv(_LONGEST)
            except TimeoutError:
                continue
            leaves = _parameter(_KEY_HASH, prefix + _PARTICIPANT) + _parameter(_STATUS, _LEAVES)
            asking.send(_HEAD + prefix + _data(prefix, 2, leaves))
            return _number_in(answer)
    raise TimeoutError


def _number_in(answer: bytes) -> int | None:
    prefix = answer[_PREFIX_AT : _PREFIX_AT + 12]
    is_numbered = prefix.startswith(_BEFORE_NUMBER) and prefix[3:] == _AFTER_NUMBER
    return prefix[len(_BEFORE_NUMBER)] if is_numbered else None


def _announcement(prefix: bytes, answered: socket.socket) -> bytes:
    host, port = answered.getsockname()[:2]
    packed = socket.inet_pton(answered.family, host)
    locator = struct.pack("<iI", 2 if len(packed) > 4 else 1, port) + packed.rjust(16, b"\0")
    properties = b"".join(map(_string, ("PARTICIPANT_TYPE", "CLIENT", "DS_VERSION", "2.0")))
    payload = (
        b"\x00\x03\x00\x00"
        + b"".join(  # a list of parameters, little-endian
            (
                _parameter(_VERSION, _HEAD[4:6]),
                _parameter(_VENDOR, _HEAD[6:8]),
                _parameter(_GUID, prefix + _PARTICIPANT),
                _parameter(_LOCATOR, locator),
                _parameter(_DATA_LOCATOR, locator),
                _parameter(_LEASE, struct.pack("<iI", _LEAVES_BY_ITSELF, 0)),
                _parameter(_ENDPOINTS, struct.pack("<I", 3)),  # it announces and finds participants, and no more
                _parameter(_PROPERTIES, struct.pack("<I", 2) + properties),
                _parameter(_SENTINEL, b""),
            )
        )
    )
    return _HEAD + prefix + _data(prefix, 1, b"", payload)


def _data(prefix: bytes, number: int, inline: bytes, payload: bytes = b"") -> bytes:
    """Return a submessage of the participant's writer, with the number of the sample."""
    sample = struct.pack("<iI", 0, number)
    identity = prefix + _WRITER + sample
    inline = _parameter(_IDENTITY, identity) + _parameter(_IDENTITY_2, identity) + inline + _parameter(_SENTINEL, b"")
    body = struct.pack("<HH", 0, 16) + _READER + _WRITER + sample + inline + payload
    flags = _ENDIAN | _HAS_INLINE_QOS | (_HAS_PAYLOAD if payload else 0)
    return struct.pack("<BBH", _DATA, flags, len(body)) + body


def _parameter(number: int, value: bytes) -> bytes:
    padded = value + bytes(-len(value) % 4)
    return struct.pack("<HH", number, len(padded)) + padded


def _string(text: str) -> bytes:
    ended = text.encode() + b"\0"
    return struct.pack("<I", len(ended)) + ended + bytes(-len(ended) % 4)
