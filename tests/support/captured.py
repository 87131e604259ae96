"""Other programs, run to their end."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any


def captured(*command: str | Path, check: bool = False, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a program, and return its exit code and its output as text; `options` go to `subprocess.run`."""
    options = {"timeout": 120, **options}
    return subprocess.run(command, check=check, capture_output=True, text=True, **options)


def own_lines(errors: str) -> list[str]:
    """Leave out what Fast DDS says of ports in shared memory that killed processes of other tests left."""
    return [line for line in errors.splitlines() if "RTPS_TRANSPORT_SHM" not in line]
