"""A message that takes over the process that draws finds no file, no network, no program and no rights."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import io
import json
import os
import platform
import socket
import struct
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Vector3
from nav_msgs.msg import MapMetaData, OccupancyGrid, Odometry
from rcl_interfaces.msg import Log
from sensor_msgs.msg import BatteryState, CompressedImage, Image, JointState, LaserScan, NavSatFix
from std_msgs.msg import Header
from tests.support.other_user import only_root, process_of_other
from visualization_msgs.msg import Marker

from rsb_extras.pictures import confinement
from rsb_extras.pictures import renderer as renderer_module
from rsb_extras.pictures.confinement import Confinement
from rsb_extras.pictures.picture import Wish
from rsb_extras.pictures.seccomp import REFUSED, filter_program
from rsb_extras.pictures.tests import picture_places
from rsb_extras.pictures.tests.samples import task

if TYPE_CHECKING:
    from rsb_extras.pictures.renderer import Renderer

_TRIES = """
import ctypes, json, os, signal, socket, sys, threading
from rsb_extras.pictures.confinement import confine
secret, written, port = sys.argv[1:]
libc, own, parent = ctypes.CDLL(None, use_errno=True), os.open(secret, os.O_RDONLY), os.getppid()
held = confine()._asdict()

def call(name, *arguments):
    if getattr(libc, name)(*arguments) < 0:
        raise OSError(ctypes.get_errno(), name)

def refused(act):
    try:
        act()
    except OSError as error:
        return error.errno
    return 0

started = threading.Thread(target=lambda: None)
started.start()
started.join()
print(json.dumps(held | {"imports": bool(__import__("zipfile"))} | {name: refused(act) for name, act in {
    "reads": lambda: open(secret),
    "lists": lambda: os.listdir(os.path.dirname(secret)),
    "writes": lambda: open(written, "w"),
    "overwrites": lambda: os.open(secret, os.O_RDWR),
    "removes": lambda: os.remove(secret),
    "locks": lambda: os.chmod(secret, 0),
    "locks opened": lambda: os.fchmod(own, 0),
    "connects": lambda: socket.create_connection(("127.0.0.1", int(port))),
    "listens": lambda: socket.create_server(("127.0.0.1", 0)),
    "attaches": lambda: socket.socket(socket.AF_UNIX),
    "sends datagrams": lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM),
    "asks the kernel": lambda: socket.socket(socket.AF_NETLINK, socket.SOCK_RAW),
    "pairs": lambda: socket.socketpair(),
    "runs": lambda: os.execv("/bin/true", ["true"]),
    "forks": lambda: os.fork() or os._exit(0),
    "spawns": lambda: os.posix_spawn("/bin/true", ["true"], {}),
    "signals": lambda: os.kill(parent, 0),
    "signals by input": lambda: __import__("fcntl").fcntl(0, 8, parent),
    "traces": lambda: call("ptrace", 0x4206, parent, None, None),
    "reads memory": lambda: call("process_vm_readv", parent, None, 0, None, 0, 0),
    "limits": lambda: __import__("resource").prlimit(parent, 7, (0, 0)),
    "shares memory": lambda: call("shmget", 1, 4096, 0o1600),
    "io_uring": lambda: call("syscall", 425, 1, bytes(120)),
    "pidfd": lambda: call("syscall", 434, parent, 0),
    "clone3": lambda: call("syscall", 435, None, 0),
}.items()}))
"""
_SET_DUMPABLE = 4
_ALLOW = 0x7FFF0000
_ARGUMENTS: list[tuple[str, tuple[int, ...], tuple[int, ...]]] = [
    ("openat", (0, 0, os.O_RDONLY | os.O_CLOEXEC), (0, 0, os.O_WRONLY)),
    ("clone", (0x10000 | 17,), (17,)),
    ("fcntl", (0, fcntl.F_SETFL), (0, fcntl.F_SETOWN)),
    ("prlimit64", (0,), (1,)),
]
"""Calls that are allowed with the first arguments, and not with the second."""
_NEW_CALLS = ("io_uring", "pidfd", "clone3")


@pytest.fixture
def tried(tmp_path: Path) -> dict[str, Any]:
    """The requests that a confined process was refused."""
    secret = tmp_path / "robot1.key"
    secret.write_text("secret")
    with socket.create_server(("127.0.0.1", 0)) as server:
        arguments = (str(secret), str(tmp_path / "written"), str(server.getsockname()[1]))
        ran = subprocess.run(
            (sys.executable, "-P", "-c", _TRIES, *arguments), capture_output=True, text=True, check=True, timeout=180
        )
    found: dict[str, Any] = json.loads(ran.stdout)
    return found


def test_attacker_in_the_drawing_process(tried: dict[str, Any]) -> None:
    assert tried["no_new_privileges"]
    assert tried["no_capabilities"]
    assert tried["imports"]
    assert tried["filtered"] == (platform.machine() in ("x86_64", "aarch64"))
    refused = {name: number for name, number in tried.items() if name not in Confinement._fields and name != "imports"}
    reading = {refused.pop("reads"), refused.pop("lists")}
    assert reading == {errno.EACCES if tried["landlock"] else 0}
    if not tried["filtered"]:
        pytest.skip("the numbers of this machine's system calls are not known")
    assert {refused.pop(name) for name in _NEW_CALLS} == {errno.ENOSYS}
    assert {name for name, number in refused.items() if number != errno.EPERM} == set()


@only_root
@pytest.mark.parametrize("landlock", [0, 7])
def test_bridge_hides_its_memory_if_landlock_does_not(landlock: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """From a child of its own user's, which is not root: a child of root's that draws has none of root's rights."""
    monkeypatch.setattr(confinement, "_landlock_version", lambda libc: landlock)
    reads, writes = os.pipe()

    def bridge() -> None:
        ctypes.CDLL(None).prctl(_SET_DUMPABLE, 1, 0, 0, 0)  # which another user's process is not before an exec
        confinement.hide_memory()
        if os.fork():
            os.wait()
            return
        try:
            os.close(os.open(f"/proc/{os.getppid()}/mem", os.O_RDONLY))
            os.write(writes, b"0")
        except OSError as error:
            os.write(writes, str(error.errno).encode())

    with process_of_other(bridge):
        found = int(os.read(reads, 10))
    for each in (reads, writes):
        os.close(each)
    if landlock and Path("/proc/sys/kernel/yama/ptrace_scope").exists():
        pytest.skip("the kernel may close it to each child")
    assert found == (0 if landlock else errno.EACCES)


async def test_bridge_hides_its_memory_before_drawing(renderer: Renderer) -> None:
    with patch.object(subprocess, "Popen", side_effect=OSError), patch.object(renderer_module, "hide_memory") as hides:
        await renderer.draw(task(Wish(), Vector3(x=1.0)))
    hides.assert_called_once()


def _answer(program: bytes, audit: int, number: int, *arguments: int) -> int:
    """Return what the kernel would answer a system call after a filter."""
    data = struct.pack("=IIQ6Q", number, audit, 0, *arguments, *[0] * (6 - len(arguments)))
    instructions, at, word = list(struct.iter_unpack("=HBBI", program)), 0, 0
    while True:
        code, if_true, if_false, value = instructions[at]
        at += 1
        match code:
            case 0x06:
                return int(value)
            case 0x20:
                word = int.from_bytes(data[value : value + 4], "little")
            case 0x15 | 0x35 | 0x45:
                holds = {0x15: word == value, 0x35: word >= value, 0x45: bool(word & value)}[code]
                at += if_true if holds else if_false
            case _:
                pytest.fail(f"{code:#x} is no instruction that the filter needs")


@pytest.mark.parametrize(("machine", "audit"), [("x86_64", 0xC000003E), ("aarch64", 0xC00000B7)])
def test_filter_of_each_machine(machine: str, audit: int) -> None:
    """The numbers are the same as libseccomp's."""
    library = ctypes.CDLL("libseccomp.so.2")

    def number(name: str) -> int:
        return int(library.seccomp_syscall_resolve_name_arch(audit, name.encode()))

    program = filter_program(machine)
    assert program is not None
    refused, missing = 0x00050000 | errno.EPERM, 0x00050000 | errno.ENOSYS
    for name in REFUSED:
        assert number(name) < 0 or _answer(program, audit, number(name)) == refused, name
    for name in ("io_uring_setup", "clone3", "pidfd_open", "open_tree"):
        assert _answer(program, audit, number(name)) == missing, name
    for name in ("read", "write", "mmap", "futex", "exit_group", "clock_gettime", "getdents64"):
        assert _answer(program, audit, number(name)) == _ALLOW, name
    for name, allowed, not_allowed in _ARGUMENTS:
        assert _answer(program, audit, number(name), *allowed) == _ALLOW, name
        assert _answer(program, audit, number(name), *not_allowed) == refused, name
    assert _answer(program, 0x40000003, number("read")) == 0x80000000  # another architecture's: i386
    assert _answer(program, audit, 0x40000000 | 41) == missing  # x32's socket


def test_no_filter_for_an_unknown_machine() -> None:
    assert filter_program("riscv64") is None


async def test_the_drawing_process_is_confined_and_draws(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also what imports Pillow and numpy only then, which may take over 3 s at low priority."""
    picture_places.DRAWING_WITHIN.set(monkeypatch, 60.0)
    image = pytest.importorskip("PIL.Image")
    encoded = io.BytesIO()
    image.new("RGB", (8, 8), "red").save(encoded, "jpeg")
    messages = [
        CompressedImage(format="jpeg", data=encoded.getvalue()),
        Image(encoding="rgb8", width=8, height=8, data=bytes(192)),
        LaserScan(ranges=[1.0, 2.0], angle_increment=0.1, range_max=9.0),
        OccupancyGrid(info=MapMetaData(width=8, height=8, resolution=0.1), data=[0] * 64),
        Odometry(header=Header(frame_id="odom"), child_frame_id="base"),
        JointState(name=["elbow"], position=[1.0]),
        BatteryState(percentage=0.5),
        Marker(type=Marker.SPHERE, header=Header(frame_id="map")),
        DiagnosticArray(status=[DiagnosticStatus(name="motor")]),
        Log(msg="started"),
        NavSatFix(latitude=1.0, longitude=1.0),
        Vector3(x=1.0),
    ]
    for view, message in enumerate(messages):
        picture = await renderer.draw(task(Wish(webp=True, across=4, down=8), message, view=view))
        assert (picture.problem, picture.content is None) == ("", False), message
    assert renderer.starts == 1
    status = dict(line.split(":\t", 1) for line in Path(f"/proc/{renderer.pid}/status").read_text().splitlines())
    assert status["NoNewPrivs"] == "1"
    assert {int(status[each], 16) for each in ("CapEff", "CapPrm", "CapInh", "CapAmb")} == {0}
    limits = Path(f"/proc/{renderer.pid}/limits").read_text()
    assert "Max file size             0 " in limits
    assert (status["Seccomp"] == "2") == (filter_program(platform.machine()) is not None)
