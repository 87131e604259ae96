"""Machines where Bluetooth can't be had. Sockets are refused for real, by seccomp, as a container does it."""

from __future__ import annotations

import errno
import json
import os
import platform
import socket
import subprocess
import sys

import pytest
from tests.support.wording import pattern, says

from rsb_bridge.bluetooth import hci
from rsb_bridge.bluetooth.hci import NoBluetooth

_REFUSED = """
import ctypes, struct, sys
from rsb_console.command.bt_scan import run_bt_scan

PR_SET_NO_NEW_PRIVS, PR_SET_SECCOMP, SECCOMP_MODE_FILTER = 38, 22, 2
LOAD, EQUAL, RETURN, ERRNO, ALLOW = 0x20, 0x15, 0x06, 0x50000, 0x7FFF0000
SOCKET, AF_BLUETOOTH = {"x86_64": 41, "aarch64": 198}[sys.argv[2]], 31
program = b"".join(struct.pack("HBBI", *instruction) for instruction in [
    (LOAD, 0, 0, 0), (EQUAL, 0, 3, SOCKET),
    (LOAD, 0, 0, 16), (EQUAL, 0, 1, AF_BLUETOOTH),
    (RETURN, 0, 0, ERRNO | int(sys.argv[1])), (RETURN, 0, 0, ALLOW),
])
code = ctypes.create_string_buffer(program)
libc = ctypes.CDLL(None, use_errno=True)
assert libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0
filter = ctypes.create_string_buffer(struct.pack("HxxxxxxP", len(program) // 8, ctypes.addressof(code)))
assert libc.prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, filter, 0, 0) == 0
sys.exit(run_bt_scan(None, as_json=True))
"""


@pytest.mark.parametrize(
    ("refusal", "code", "parameters"),
    [
        (errno.EAFNOSUPPORT, NoBluetooth.NOT_IN_KERNEL, {}),
        (errno.EPROTONOSUPPORT, NoBluetooth.NO_RFCOMM, {}),
        (errno.EPERM, NoBluetooth.FORBIDDEN, {}),
        (errno.EACCES, NoBluetooth.FORBIDDEN_BY_SECURITY_MODULE, {}),
        (errno.EMFILE, NoBluetooth.REFUSED, {"reason": os.strerror(errno.EMFILE)}),
    ],
)
def test_refused_sockets_are_explained(refusal: int, code: NoBluetooth, parameters: dict[str, str]) -> None:
    command = [sys.executable, "-c", _REFUSED, str(refusal), platform.machine()]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (1, "")
    found = json.loads(ran.stdout)
    assert found["adapters"] == []
    assert says(found["problems"][0], code, **parameters)


def test_a_python_without_bluetooth_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The attribute is taken away: a Python built without it can't be had everywhere."""
    monkeypatch.delattr(socket, "AF_BLUETOOTH", raising=False)
    with pytest.raises(hci.NoBluetoothError, match=pattern(NoBluetooth.NOT_IN_PYTHON)):
        hci.rfcomm_socket()
