"""Runs a command as a systemd unit confines it, as far as that goes without systemd.

``python -m tests.support.sandbox UNIT COMMAND ...``: the unit's UMask, LimitNOFILE, NoNewPrivileges, SystemCallFilter
and RestrictAddressFamilies; run as root, its empty CapabilityBoundingSet, too. Not its mounts, such as ProtectSystem.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import errno
import os
import resource
import socket
import subprocess
import sys
from pathlib import Path

_PR_CAPBSET_DROP, _PR_SET_NO_NEW_PRIVS = 24, 38
_LAST_CAPABILITY = 40
_ALLOW, _ERRNO = 0x7FFF0000, 0x00050000
_EQUAL = 4
_FAMILIES = {name: value for name, value in vars(socket).items() if name.startswith("AF_")} | {"AF_BLUETOOTH": 31}


class _Comparison(ctypes.Structure):
    """A scmp_arg_cmp."""

    _fields_ = (("arg", ctypes.c_uint), ("op", ctypes.c_int), ("a", ctypes.c_uint64), ("b", ctypes.c_uint64))


def main(unit: Path, command: list[str]) -> None:
    """Confine this process, and become the command."""
    lines = [line.partition("=")[::2] for line in unit.read_text(encoding="utf-8").splitlines() if "=" in line]
    options = dict(lines)
    calls = system_calls([value for name, value in lines if name == "SystemCallFilter"])
    os.umask(int(options["UMask"], 8))
    files = min(int(options["LimitNOFILE"]), resource.getrlimit(resource.RLIMIT_NOFILE)[1])
    resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))
    libc = ctypes.CDLL(None)
    if os.getuid() == 0:
        for capability in range(_LAST_CAPABILITY + 1):
            libc.prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0)
    libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    _filter(calls, [_FAMILIES[name] for name in options["RestrictAddressFamilies"].split()])
    os.execvp(command[0], command)


def system_calls(filters: list[str]) -> set[str]:
    """The system calls that a unit's filters leave."""
    allowed: set[str] = set()
    for each in filters:
        named = set().union(*(_members(name) for name in each.removeprefix("~").split()))
        allowed = allowed - named if each.startswith("~") else allowed | named
    return allowed


def _members(name: str) -> set[str]:
    if not name.startswith("@"):
        return {name}
    run = subprocess.run(
        ["systemd-analyze", "syscall-filter", "--no-pager", name], capture_output=True, text=True, check=True
    )
    words = {line.strip() for line in run.stdout.splitlines()[1:] if line.strip() and not line.strip().startswith("#")}
    return set().union(*(_members(word) for word in words))


def _filter(calls: set[str], families: list[int]) -> None:
    library = ctypes.CDLL(ctypes.util.find_library("seccomp") or "libseccomp.so.2")
    library.seccomp_init.restype = ctypes.c_void_p
    context = ctypes.c_void_p(library.seccomp_init(_ERRNO | errno.EPERM))
    for call in calls - {"socket"}:
        number = library.seccomp_syscall_resolve_name(call.encode())
        if number >= 0:  # else another machine's
            library.seccomp_rule_add_array(context, _ALLOW, number, 0, None)
    number = library.seccomp_syscall_resolve_name(b"socket")
    for family in families:
        comparison = _Comparison(0, _EQUAL, family, 0)
        library.seccomp_rule_add_array(context, _ALLOW, number, 1, ctypes.byref(comparison))
    if library.seccomp_load(context):
        raise OSError("the filter could not be loaded")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
