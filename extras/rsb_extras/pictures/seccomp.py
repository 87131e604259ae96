"""A filter of the kernel's (seccomp) that refuses this process every system call that reaches beyond it.

A filter is a program of the kernel's, of which each instruction is a `sock_filter` (linux/filter.h). It reads a
`seccomp_data`, whose first members are the call's number, the architecture and, from byte 16 on, six arguments.
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import struct
from typing import NamedTuple

_SET_SECCOMP, _MODE_FILTER = 22, 2  # prctl
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06  # a word, comparisons with it, the answer
_ALLOW, _ERRNO, _KILL = 0x7FFF0000, 0x00050000, 0x80000000
_NUMBER, _ARCHITECTURE, _ARGUMENTS = 0, 4, 16
_NEW = 424
"""Number of the first system call of Linux 5.1 on every architecture.

io_uring, pidfd, clone3, new mounts: libraries do without them, as on an older kernel. x86-64's x32 calls are above.
"""
_THREAD = 0x10000  # CLONE_THREAD
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_OWNER = 0b1000  # commands of fcntl that have another process signalled
_ALL_BITS = 0xFFFFFFFF
_POINTER = 8


class _Machine(NamedTuple):
    audit: int
    """AUDIT_ARCH_ of the machine (linux/audit.h)."""
    column: int
    """Index of its number in each call's numbers."""


_MACHINES = {"x86_64": _Machine(0xC000003E, 0), "aarch64": _Machine(0xC00000B7, 1)}

REFUSED: dict[str, tuple[int | None, int | None]] = {
    # to other processes and the network
    "socket": (41, 198), "socketpair": (53, 199), "connect": (42, 203), "bind": (49, 200), "listen": (50, 201),
    "accept": (43, 202), "accept4": (288, 242), "sendto": (44, 206), "sendmsg": (46, 211), "sendmmsg": (307, 269),
    "shmget": (29, 194), "shmat": (30, 196), "shmctl": (31, 195), "semget": (64, 190), "semctl": (66, 191),
    "msgget": (68, 186), "msgctl": (71, 187), "mq_open": (240, 180), "mq_unlink": (241, 181),
    "kill": (62, 129), "tkill": (200, 130), "tgkill": (234, 131), "rt_sigqueueinfo": (129, 138),
    "rt_tgsigqueueinfo": (297, 240), "ptrace": (101, 117), "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271), "kcmp": (312, 272), "migrate_pages": (256, 238), "move_pages": (279, 239),
    "setpriority": (141, 140), "ioprio_set": (251, 30), "sched_setaffinity": (203, 122), "sched_setattr": (314, 274),
    "sched_setparam": (142, 118), "sched_setscheduler": (144, 119),
    # to other programs
    "fork": (57, None), "vfork": (58, None), "execve": (59, 221), "execveat": (322, 281),
    # to files, beyond reading; Landlock knows no rights to change modes, owners, times and attributes
    "creat": (85, None), "truncate": (76, 45), "rename": (82, None), "renameat": (264, 38), "renameat2": (316, 276),
    "link": (86, None), "linkat": (265, 37), "symlink": (88, None), "symlinkat": (266, 36), "unlink": (87, None),
    "unlinkat": (263, 35), "mkdir": (83, None), "mkdirat": (258, 34), "rmdir": (84, None), "mknod": (133, None),
    "mknodat": (259, 33), "chmod": (90, None), "fchmod": (91, 52), "fchmodat": (268, 53), "chown": (92, None),
    "lchown": (94, None), "fchown": (93, 55), "fchownat": (260, 54), "utime": (132, None), "utimes": (235, None),
    "futimesat": (261, None), "utimensat": (280, 88), "setxattr": (188, 5), "lsetxattr": (189, 6),
    "fsetxattr": (190, 7), "removexattr": (197, 14), "lremovexattr": (198, 15), "fremovexattr": (199, 16),
    # to parts of the kernel in which errors have given rights away
    "add_key": (248, 217), "request_key": (249, 218), "keyctl": (250, 219), "bpf": (321, 280), "io_setup": (206, 0),
    "perf_event_open": (298, 241), "userfaultfd": (323, 282), "unshare": (272, 97), "setns": (308, 268),
    "mount": (165, 40), "umount2": (166, 39), "pivot_root": (155, 41), "chroot": (161, 51),
}  # fmt: skip
"""Numbers of the refused calls, on x86-64 and on aarch64; None where it has no such call."""
_REFUSED_IF: dict[str, tuple[int | None, int | None, int, int]] = {
    "open": (2, None, 1, _WRITING), "openat": (257, 56, 2, _WRITING),
    "fcntl": (72, 25, 1, _OWNER), "prlimit64": (302, 261, 0, _ALL_BITS),
}  # fmt: skip
"""Their numbers, and an argument that may have none of these bits: `prlimit64` is for process 0, which is this one."""
_CLONE = (56, 220)
"""Its first argument says whether it makes a thread or a process."""


def filter_system_calls(libc: ctypes.CDLL) -> bool:
    """Filter this process's system calls, for good; return whether the kernel does so.

    The process has no other thread yet, and no program can give it rights.
    """
    program = filter_program(platform.machine())
    if program is None or struct.calcsize("P") != _POINTER:  # a Python of 32 bits has other numbers
        return False
    instructions = ctypes.create_string_buffer(program, len(program))
    header = struct.pack("@HP", len(program) // 8, ctypes.addressof(instructions))
    return bool(libc.prctl(_SET_SECCOMP, ctypes.c_ulong(_MODE_FILTER), header, 0, 0) == 0)


def filter_program(machine: str) -> bytes | None:
    """Return the filter for a machine as `platform.machine` names it, or None if its calls' numbers are not known."""
    if (known := _MACHINES.get(machine)) is None:
        return None
    refused = _ERRNO | errno.EPERM
    # A comparison skips as many instructions as its second last number says if it is true, else as its last one.
    program: list[tuple[int, ...]] = [
        (_LOAD, _ARCHITECTURE), (_EQUAL, known.audit, 1, 0), (_RETURN, _KILL),
        (_LOAD, _NUMBER), (_AT_LEAST, _NEW, 0, 1), (_RETURN, _ERRNO | errno.ENOSYS),
    ]  # fmt: skip
    for numbers in REFUSED.values():
        if (number := numbers[known.column]) is not None:
            program += [(_EQUAL, number, 0, 1), (_RETURN, refused)]
    for *places, argument, bits in _REFUSED_IF.values():
        if (number := places[known.column]) is not None:
            load = _LOAD, _ARGUMENTS + 8 * argument
            program += [(_EQUAL, number, 0, 4), load, (_ANY_BIT, bits, 0, 1), (_RETURN, refused), (_RETURN, _ALLOW)]
    program += [(_EQUAL, _CLONE[known.column], 0, 3), (_LOAD, _ARGUMENTS), (_ANY_BIT, _THREAD, 1, 0)]
    program += [(_RETURN, refused), (_RETURN, _ALLOW)]
    return b"".join(struct.pack("=HBBI", code, *(skips or (0, 0)), value) for code, value, *skips in program)
