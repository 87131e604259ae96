"""Takes from the process that draws what drawing does not need: ``python -m rsb_extras.pictures.confinement`` tries it.

The process decodes what nodes publish, with libraries such as Pillow. A message that takes over one of them shall find
neither files nor a network, other processes or rights: with a socket alone, it could drive the robot. Each measure
holds for the rest of the process's life, or is left out where the kernel does not have it.
"""

from __future__ import annotations

import ctypes
import os
import resource
import struct
import sys
from typing import NamedTuple

import msgspec

from rsb_extras.pictures.seccomp import filter_system_calls

_SET_DUMPABLE = 4  # prctl
_NO_NEW_PRIVILEGES = 38  # prctl
_DROP_FROM_BOUNDING_SET = 24  # prctl
_CAPABILITIES = 64  # of which Linux 6 has 41
_CAPABILITY_VERSION = 0x20080522
# The same on every architecture that Python's Linux wheels are for.
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_PATH_BENEATH = 1
_READ_FILE, _READ_DIR = 1 << 2, 1 << 3
_FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 5: 16}
"""Number of rights to files that a version of Landlock knows, by the version that began with it."""
_TCP, _TCP_SINCE = 0b11, 4  # bind, connect
_SCOPES, _SCOPES_SINCE = 0b11, 6  # abstract sockets, signals
_SYSTEM = ("/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/localtime", "/sys/devices/system/cpu", "/dev/urandom")


class Confinement(NamedTuple):
    """The measures that hold.

    Attributes:
        no_new_privileges: no program can give it rights.
        no_capabilities: it has none of root's rights.
        landlock: version of the kernel's Landlock, which leaves it only the program's own files, to read, or 0.
        filtered: it has no sockets, no other processes, and writes no files (`rsb_extras.pictures.seccomp`).
    """

    no_new_privileges: bool
    no_capabilities: bool
    landlock: int
    filtered: bool


def confine() -> Confinement:
    """Confine this process, which has no other thread yet."""
    libc = ctypes.CDLL(None, use_errno=True)
    no_new_privileges = libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0) == 0
    # First: without capabilities, nothing may be dropped from the bounding set any more.
    for capability in range(_CAPABILITIES):
        libc.prctl(_DROP_FROM_BOUNDING_SET, capability, 0, 0, 0)  # only root may
    header, none = struct.pack("=Ii", _CAPABILITY_VERSION, 0), bytes(24)
    libc.capset(header, none)  # refused in the system's service, which has no capabilities anyhow
    no_capabilities, landlock, filtered = _has_no_capabilities(), 0, False
    if no_new_privileges:  # both demand it
        landlock = _landlock(libc)  # leaves no /proc to read
        filtered = filter_system_calls(libc)  # refuses Landlock's calls
    if not filtered:
        resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))  # no other process, unless it is root, but no thread either
    return Confinement(no_new_privileges, no_capabilities, landlock, filtered)


def _has_no_capabilities() -> bool:
    with open("/proc/self/status", encoding="ascii") as status:  # noqa: PTH123 -- Path costs an import
        return any(line.startswith("CapPrm:") and int(line.split()[1], 16) == 0 for line in status)


def hide_memory() -> None:
    """Close this process's memory to its user's other processes, the one that draws among them, if Landlock does not.

    With seccomp alone, that one could read it in ``/proc``. A crash of this process then leaves no core file.
    """
    libc = ctypes.CDLL(None)
    if not _landlock_version(libc):
        libc.prctl(_SET_DUMPABLE, 0, 0, 0, 0)


def _landlock_version(libc: ctypes.CDLL) -> int:
    return max(0, int(libc.syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), 1)))


def _landlock(libc: ctypes.CDLL) -> int:
    version = _landlock_version(libc)
    if not version:
        return 0
    rights = (1 << max(count for since, count in _FILE_RIGHTS.items() if since <= version)) - 1
    attributes = struct.pack("=Q", rights)
    if version >= _TCP_SINCE:
        attributes += struct.pack("=Q", _TCP)
    if version >= _SCOPES_SINCE:
        attributes += struct.pack("=Q", _SCOPES)
    ruleset = libc.syscall(_CREATE_RULESET, attributes, ctypes.c_size_t(len(attributes)), 0)
    if ruleset < 0:
        return 0
    try:
        for path in _readable():
            _allow_reading(libc, ruleset, path)
        return version if libc.syscall(_RESTRICT_SELF, ruleset, 0) == 0 else 0
    finally:
        os.close(ruleset)


def _readable() -> set[str]:
    """Return the places of Python, its modules and their libraries: drawing imports some only when they are needed."""
    libraries = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    paths = {*sys.path, *libraries, sys.prefix, sys.base_prefix, *_SYSTEM}
    return {path for path in paths if path.startswith("/") and path != "/"}  # / would be every file


def _allow_reading(libc: ctypes.CDLL, ruleset: int, path: str) -> None:
    try:
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        # For a file, the kernel refuses a rule with rights of folders.
        rights = _READ_FILE | _READ_DIR if os.path.isdir(path) else _READ_FILE  # noqa: PTH112 -- Path costs an import
        libc.syscall(_ADD_RULE, ruleset, _PATH_BENEATH, struct.pack("=Qi", rights, place), 0)
    finally:
        os.close(place)


if __name__ == "__main__":
    sys.stdout.buffer.write(msgspec.json.encode(confine()._asdict()))
