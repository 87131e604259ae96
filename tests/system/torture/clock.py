"""A wall clock that can be stepped, for the processes that are started with it; their monotonic clock goes on."""

from __future__ import annotations

import platform
import shutil
import struct
import subprocess
from pathlib import Path

POSSIBLE = shutil.which("cc") is not None and platform.machine() == "x86_64"


class SteppedClock:
    """The clock of one machine of several.

    Attributes:
        environ: variables of the processes that have this clock.
        seconds: that it differs from the true time.
    """

    def __init__(self, folder: Path, name: str) -> None:
        library = folder / "clock.so"
        if not library.exists():
            source = Path(__file__).with_name("clock.c")
            subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
        self.seconds = 0.0
        self._file = folder / f"{name}.clock"
        self._file.write_bytes(bytes(8))
        self.environ = {"LD_PRELOAD": str(library), "TORTURE_CLOCK": str(self._file)}

    def set(self, seconds: float) -> None:
        """Have the clock differ from the true time by so much."""
        self.seconds = seconds
        with self._file.open("r+b") as file:
            file.write(struct.pack("<q", round(seconds * 1e9)))
