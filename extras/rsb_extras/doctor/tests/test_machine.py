"""Findings of `rsb-console doctor` about a machine, with real files in place of ``/sys`` and ``/dev/shm``."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import pwd
import resource
import shlex
import shutil
import socket
from typing import TYPE_CHECKING, Any, ClassVar
from unittest.mock import Mock

import pytest
from tests.support import surroundings
from tests.support.addresses import foreign_address

from rsb_bridge.feature import Feature
from rsb_bridge.model.finding import Check, Finding, Grade, examine, worst
from rsb_bridge.transport.transport import RECEIVE_BUFFER
from rsb_bridge.transport.udp import enlarge_buffers
from rsb_extras.doctor import machine
from rsb_extras.doctor.tests import doctor_places

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


def found(code: str, root: Path, environ: dict[str, str] | None = None) -> list[Finding]:
    environ = environ or {"XDG_STATE_HOME": str(root)}
    return list(examine(check for check in machine.checks(environ, root) if check.code == code))


def grades(findings: list[Finding]) -> list[tuple[str, Grade]]:
    return [(each.code, each.grade) for each in findings]


@pytest.mark.parametrize(("given", "grade"), [(212_992, Grade.WARNING), (RECEIVE_BUFFER, Grade.OK)])
def test_what_a_udp_socket_may_hold(given: int, grade: Grade, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    doctor_places.GRANTED_RECEIVE_BUFFER.set(monkeypatch, lambda _: given)
    (finding,) = found("udp_buffers", tmp_path)
    assert finding.grade == grade
    assert finding.facts["given"] == given
    assert (str(RECEIVE_BUFFER) in finding.remedy) == (grade == Grade.WARNING)


def test_udp_socket_is_asked_as_bridge_asks_it(tmp_path: Path) -> None:
    """Root, and a process with CAP_NET_ADMIN, get more than net.core.rmem_max."""
    with socket.socket(type=socket.SOCK_DGRAM) as asking:
        enlarge_buffers(asking)
        (finding,) = found("udp_buffers", tmp_path)
        assert finding.facts["given"] == asking.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


@pytest.mark.parametrize(("used", "grade"), [("bbr", Grade.OK), ("cubic", Grade.NOTE)])
def test_congestion_control_that_takes_loss_for_full_link(
    used: str, grade: Grade, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    doctor_places.CONGESTION_CONTROL.set(monkeypatch, lambda _: used)
    (finding,) = found("congestion_control", tmp_path)
    assert (finding.grade, finding.facts) == (grade, {"used": used})
    assert ("tcp_bbr" in finding.remedy) == (grade == Grade.NOTE)


def test_kernel_that_tells_no_changes_of_the_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert grades(found("network_news", tmp_path)) == [("network_news", Grade.OK)]

    def refuse() -> socket.socket:
        raise OSError(errno.EAFNOSUPPORT, "refused")

    doctor_places.OPEN_NEWS.set(monkeypatch, refuse)
    (finding,) = found("network_news", tmp_path)
    assert finding.grade == Grade.NOTE
    assert os.strerror(errno.EAFNOSUPPORT) in finding.text
    assert "AF_NETLINK" in finding.remedy


def test_files_are_counted_once_their_program_was_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "dev/shm"
    folder.mkdir(parents=True)
    for name in ("fastrtps_0a", "fastdds_0b", "fastdds_port7411"):
        (folder / name).write_bytes(bytes(2 << 20))
        (folder / f"{name}_el").touch()
    doctor_places.LITTLE_SHARED_MEMORY.set(monkeypatch, 0)
    assert grades(found("shared_memory", tmp_path)) == [("shared_memory", Grade.OK)]  # they are too new to tell
    doctor_places.LOCKED_WITHIN.set(monkeypatch, -1.0)
    with (folder / "fastdds_0b_el").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        _, left = found("shared_memory", tmp_path)
    assert (left.code, left.facts) == ("shared_memory_left", {"files": 1, "bytes": 2 << 20})
    assert left.remedy.endswith("fastdds shm clean")  # of the ROS that the tests have; it spares nodes that run


def test_shared_memory_of_several_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for a node of another user, which only root could start."""
    folder = tmp_path / "dev/shm"
    folder.mkdir(parents=True)
    doctor_places.LITTLE_SHARED_MEMORY.set(monkeypatch, 0)
    doctor_places.LOCKED_WITHIN.set(monkeypatch, -1.0)
    own, other = os.geteuid(), 4_000_000_000
    with (folder / "fastdds_0a_el").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert grades(found("shared_memory", tmp_path)) == [("shared_memory", Grade.OK)]
        surroundings.set_user(monkeypatch, other)
        _, several = found("shared_memory", tmp_path)
    assert (several.code, several.grade) == ("shared_memory_users", Grade.WARNING)
    assert several.facts["users"] == sorted((pwd.getpwuid(own).pw_name, str(other)))


def test_little_shared_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "dev/shm").mkdir(parents=True)
    doctor_places.LITTLE_SHARED_MEMORY.set(monkeypatch, 1 << 60)
    assert grades(found("shared_memory", tmp_path)) == [("shared_memory", Grade.WARNING)]
    assert grades(found("shared_memory", tmp_path / "none")) == [("shared_memory", Grade.UNKNOWN)]


def chain(name: str, hook: str = "", policy: str = "accept") -> dict[str, Any]:
    """A chain as nft lists it; without a hook, others jump to it."""
    of_hook = {"hook": hook, "policy": policy} if hook else {}
    return {"chain": {"family": "ip", "table": "a", "name": name, **of_hook}}


def rule(of: str, *expressions: dict[str, Any]) -> dict[str, Any]:
    return {"rule": {"family": "ip", "table": "a", "chain": of, "expr": list(expressions)}}


@pytest.mark.parametrize(
    ("rules", "chains"),
    [
        ([], []),
        ([chain("INPUT", "input")], []),
        ([chain("INPUT", "input", "drop")], ["ip a INPUT"]),
        ([chain("INPUT", "input"), rule("INPUT", {"counter": {"packets": 1}}, {"reject": None})], ["ip a INPUT"]),
        ([chain("INPUT", "input"), rule("INPUT", {"xt": {"type": "target", "name": "REJECT"}})], ["ip a INPUT"]),
        ([chain("FORWARD", "forward", "drop"), chain("DOCKER"), rule("DOCKER", {"drop": None})], []),
        (
            [chain("INPUT", "input"), chain("b"), chain("c"), rule("INPUT", {"jump": {"target": "b"}}),
             rule("b", {"goto": {"target": "c"}}), rule("c", {"jump": {"target": "b"}}, {"drop": None})],
            ["ip a c"],
        ),
        (
            [chain("INPUT", "input"),
             {"map": {"family": "ip", "table": "a", "name": "m", "elem": [[1, {"drop": None}]]}},
             rule("INPUT", {"vmap": {"key": {"meta": {"key": "iif"}}, "data": "@m"}})],
            ["ip a @m"],
        ),
    ],
)  # fmt: skip
def test_chains_that_drop_packets_to_this_machine(rules: list[dict[str, Any]], chains: list[str]) -> None:
    assert machine.dropping_chains(rules) == chains


@pytest.mark.parametrize(
    ("rules", "code", "euid", "grade"),
    [
        (json.dumps({"nftables": [chain("INPUT", "input")]}), 0, 0, Grade.OK),
        (json.dumps({"nftables": [chain("INPUT", "input", "drop")]}), 0, 0, Grade.NOTE),
        ("", 1, 0, Grade.UNKNOWN),
        ("", 0, 1000, Grade.UNKNOWN),
    ],
)
def test_rules_that_drop_packets(
    rules: str, code: int, euid: int, grade: Grade, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "nft"
    program.write_text(f"#!/bin/sh\necho '{rules}'\nexit {code}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    surroundings.set_user(monkeypatch, euid)
    (finding,) = found("firewall", tmp_path)
    assert finding.grade == grade


@pytest.mark.parametrize(("names", "grade"), [(["hci0", "hci0:1"], Grade.OK), ([], Grade.NOTE)])
def test_bluetooth_adapters(names: list[str], grade: Grade, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    surroundings.offer_bluetooth(monkeypatch)
    for name in names:
        (tmp_path / "sys/class/bluetooth" / name).mkdir(parents=True)
    (finding,) = found("bluetooth", tmp_path)
    assert (finding.grade, finding.facts["adapters"]) == (grade, [name for name in names if ":" not in name])


def test_a_python_without_bluetooth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(socket, "AF_BLUETOOTH", raising=False)
    (finding,) = found("bluetooth", tmp_path)
    assert (finding.grade, finding.facts) == (Grade.NOTE, {"sockets": False})


@pytest.mark.parametrize(
    ("hard", "grade"), [(1024, Grade.WARNING), (65_536, Grade.OK), (resource.RLIM_INFINITY, Grade.OK)]
)
def test_open_files(hard: int, grade: Grade, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    doctor_places.OPEN_FILES.set(monkeypatch, lambda _: (1024, hard))
    assert grades(found("descriptors", tmp_path)) == [("descriptors", grade)]


def test_a_full_disk_and_a_foreign_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert grades(found("disk", tmp_path)) == [("disk", Grade.OK)]
    usage = shutil.disk_usage(tmp_path)
    doctor_places.DISK_USAGE.set(monkeypatch, lambda _: usage._replace(free=1 << 20))
    assert grades(found("disk", tmp_path)) == [("disk", Grade.WARNING)]
    surroundings.forbid_access(monkeypatch)
    (finding,) = found("disk", tmp_path)
    assert (finding.grade, str(tmp_path) in finding.remedy) == (Grade.WARNING, True)
    doctor_places.FILE_SYSTEM.set(monkeypatch, lambda _: Mock(f_flag=os.ST_RDONLY))
    (finding,) = found("disk", tmp_path)
    assert "read-only" in finding.text


def test_no_remedy_takes_away_folder_above_missing_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A service's user may have a home that does not exist: the nearest folder that does is ``/``."""
    surroundings.forbid_access(monkeypatch)
    folder = tmp_path / "missing home" / "rsb-console"
    (finding,) = found("disk", tmp_path, {"STATE_DIRECTORY": str(folder)})
    command = shlex.split(finding.remedy, comments=True)
    assert (finding.grade, command[-1]) == (Grade.WARNING, str(folder))
    assert "chown" not in command


def test_missing_extras_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class One(Feature):
        name = "one"
        libraries: ClassVar[Mapping[str, str]] = {"zenoh": "no_such_module", "other": "json"}

    doctor_places.INSTALLED.set(monkeypatch, lambda: (One(),))
    (finding,) = found("extras", tmp_path)
    assert (finding.grade, finding.facts["zenoh"], finding.facts["other"]) == (Grade.NOTE, False, True)
    assert "[zenoh]" in finding.remedy


def test_multicast_comes_back_without_leaving_the_machine() -> None:
    assert machine.comes_back("127.0.0.1")
    assert not machine.comes_back(foreign_address())


def test_multicast_by_interface(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flags = {"lo": 0x9, "up": 0x1001, "deaf": 0x1, "down": 0x1000}
    addresses = dict.fromkeys(flags, "127.0.0.1")
    doctor_places.INTERFACES.set(monkeypatch, lambda: list(enumerate(flags)))
    doctor_places.INTERFACE_FLAGS.set(monkeypatch, flags.get)
    doctor_places.INTERFACE_ADDRESS.set(monkeypatch, addresses.get)
    good, bad = found("multicast", tmp_path)
    assert [good.grade, bad.grade] == [Grade.OK, Grade.WARNING]
    assert good.facts == {"up": True, "deaf": False}
    assert "deaf" in bad.remedy
    flags.clear()
    assert grades(found("multicast", tmp_path)) == [("multicast", Grade.NOTE)]


def test_the_clock_is_asked(tmp_path: Path) -> None:
    (finding,) = found("clock", tmp_path)
    assert finding.grade == (Grade.OK if finding.facts["synchronized"] else Grade.WARNING)
    assert finding.facts["max_error"] >= 0


def test_a_check_that_fails_is_a_finding() -> None:
    def fails() -> Any:
        raise OSError("no \x1b[31mway")

    def is_wrong() -> Any:
        yield Finding("bug", Grade.OK, "bug", "")
        raise KeyError("\x1b[31mdefect")

    first, second, last = examine([Check("bug", "bug", is_wrong), Check("b", "b", fails)])
    assert [first.grade, second.grade, last.grade] == [Grade.OK, Grade.UNKNOWN, Grade.UNKNOWN]
    assert (second.code, second.facts, "\x1b" in second.text) == ("bug", {"internal_error": True}, False)
    assert second.remedy
    (finding,) = examine([Check("it", "it", fails)])
    assert (finding.grade, "\x1b" in finding.text) == (Grade.UNKNOWN, False)
    assert worst([finding, Finding("a", Grade.OK, "a", "")]) == Grade.UNKNOWN
    assert worst([]) == Grade.OK
