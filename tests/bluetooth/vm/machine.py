"""Boots the machine and runs pytest selections in it."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, NamedTuple

from tests.bluetooth.vm.cpio import Archive

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tests.bluetooth.vm.layers import Layers

_PROJECT = Path(__file__).parents[3]
_TAKEN_ALONG = ("bridge/rsb_bridge", "console/rsb_console", "tests/bluetooth")
_FILES_TAKEN_ALONG = ("pyproject.toml", "tests/support/wording.py", "tests/support/coroutines.py")
# What is switched off costs start-up time, or hides a fault (a kernel oops ends it).
_KERNEL_OPTIONS = (
    "console=ttyS0 loglevel=5 panic=-1 oops=panic mitigations=off nokaslr random.trust_cpu=on audit=0"
    " cryptomgr.notests=1 apparmor=0"
)
# One CPU: emulated, two are slower. Its clock counts instructions, 4 ns each, and jumps to the next timer when there is
# nothing to do: what happens in it does not depend on how fast it is emulated, and what waits there takes no time here.
# The plainest CPU: wide registers are emulated word by word, and programs that find them use them.
_QEMU = (
    "qemu-system-x86_64 -accel tcg,thread=single -icount shift=2,sleep=off -rtc clock=vm -machine pc -cpu qemu64 -smp 1"
    " -m 1024 -nodefaults -no-user-config -display none -nic none -no-reboot"
)
_TIME_LIMIT = 1500.0
_CONSOLE_LINES = 60  # a kernel trace
_END = "\f"  # after each command's output


class Outcome(NamedTuple):
    """The results of a run of pytest.

    Attributes:
        exit_code: pytest's.
        output: pytest's, standard output and error.
        console: the machine's: the kernel's and the init's messages.
    """

    exit_code: int
    output: str
    console: str


class DiedError(Exception):
    """The machine ended, or was ended after its time limit, without an exit code; the message has its last words."""


def run(layers: Layers, *selections: Sequence[str], time_limit: float = _TIME_LIMIT) -> list[Outcome]:
    """Run ``pytest *selection`` for each in turn, in one machine, as root, in a copy of the project's folder.

    Args:
        layers: what it boots from.
        selections: pytest's arguments; paths as in the project's folder.
        time_limit: s, for the machine from power-on to power-off.

    Raises:
        DiedError: an exit code is missing.
    """
    commands = [shlex.join(["python3.11", "-m", "pytest", "-p", "no:cacheprovider", *each]) for each in selections]
    with tempfile.TemporaryDirectory(prefix="bluetooth-vm-") as folder:
        work = Path(folder)
        _write_initrd(work / "initrd", layers.initrd, commands)
        serial = [work / name for name in ("console", "output", "exit")]
        qemu: list[str | Path] = [
            *_QEMU.split(),
            "-kernel",
            layers.kernel,
            "-initrd",
            work / "initrd",
            "-append",
            _KERNEL_OPTIONS,
        ]
        for file in serial:
            qemu += ["-serial", f"file:{file}"]
        ended = "it ended"
        try:
            subprocess.run(qemu, stdin=subprocess.DEVNULL, check=True, timeout=time_limit)
        except subprocess.TimeoutExpired:
            ended = f"it was ended after {time_limit:.0f} s"
        console, output, exit_lines = (file.read_text(errors="replace") for file in serial)
    codes = [int(code) for code in re.findall(r"exit (\d+)", exit_lines)]
    if len(codes) < len(selections):
        last = "\n".join(console.splitlines()[-_CONSOLE_LINES:])
        raise DiedError(f"the machine gave no exit code: {ended}\n--- output\n{output}\n--- console\n{last}")
    return [Outcome(code, each, console) for code, each in zip(codes, output.split(_END), strict=False)]


def _write_initrd(path: Path, base: Path, commands: list[str]) -> None:
    shutil.copyfile(base, path)
    with path.open("ab") as file, Archive(file) as archive:
        archive.add(PurePosixPath("commands"), "".join(f"{command}\n" for command in commands).encode())
        for name in _FILES_TAKEN_ALONG:
            archive.add(PurePosixPath("project", name), (_PROJECT / name).read_bytes())
        for folder in _TAKEN_ALONG:
            for source in sorted((_PROJECT / folder).rglob("*.py")):
                archive.add(PurePosixPath("project", source.relative_to(_PROJECT)), source.read_bytes())
