"""Runs ``make test`` on each supported Python that this machine has: on PATH, or of pyenv (``make test-pythons``).

Each has an environment of its own, such as ``.venv-3.12``.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

VERSIONS = ("3.11", "3.12", "3.13", "3.14")
UNSTABLE = Path("build/unstable.txt")
TELL = "import sys; print('.'.join(map(str, sys.version_info[:3])))"


def main() -> int:
    """Return 1 if one run failed, or no Python is there."""
    codes: list[int] = []
    lines: list[str] = []
    unstable: list[str] = []
    for version in VERSIONS:
        program, found = find(version)
        if not program:
            lines.append(f"{version}: skipped, as this machine does not have it")
            continue
        sys.stdout.write(f"Python {found}: {program}\n")
        sys.stdout.flush()
        began = time.monotonic()
        codes.append(
            subprocess.run(["make", "test", f"VENV=.venv-{version}", f"PYTHON={program}"], check=False).returncode
        )
        again = UNSTABLE.read_text(encoding="utf-8").splitlines() if UNSTABLE.exists() else []
        unstable += again
        result = "failed" if codes[-1] else " ".join(("passed, unstable:", *again)) if again else "passed"
        lines.append(f"{found}: {result} ({(time.monotonic() - began) / 60:.0f} min)")
    if unstable:
        UNSTABLE.write_text("".join(f"{each}\n" for each in dict.fromkeys(unstable)), encoding="utf-8")
    sys.stdout.write("\n".join(("", *lines, "")))
    return int(any(codes) or not codes)


def find(version: str) -> tuple[str, str]:
    """Return the newest Python of a version, and its whole version, or empty texts."""
    root = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    found = {told: program for program in (f"python{version}", *map(str, root.glob(f"versions/{version}*/bin/python")))
             if (told := tell(program)).startswith(f"{version}.")}  # fmt: skip
    newest = max(found, key=lambda told: int(told.rpartition(".")[2]), default="")
    return found.get(newest, ""), newest


def tell(program: str) -> str:
    """Return a Python's version, or an empty text: pyenv has a program for each of its Pythons that only complains."""
    try:
        return subprocess.run([program, "-P", "-c", TELL], capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


if __name__ == "__main__":
    sys.exit(main())
