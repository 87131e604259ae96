"""Installs this checkout into an environment, and tells how far it is: ``install.py PYTHON '.[EXTRAS]'``."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

SIZE = 130  # MB that pip downloads for `make demo`, about, if its cache has nothing
DOWNLOADING = re.compile(r"\s*(Downloading|Using cached) \S+ \((?P<size>[\d.]+) (?P<unit>bytes|kB|MB)\)\n")
UNITS = {"bytes": 1e-6, "kB": 1e-3, "MB": 1.0}
LOG_EVERY = 5.0  # s
LOG = Path("build/install.log")
CAUSES = {
    r"NewConnectionError|NameResolutionError|ConnectTimeout|ReadTimeout|ProxyError|Network is unreachable": (
        "the package index cannot be reached: check the network and the proxy, or name a mirror with PIP_INDEX_URL"
    ),
    r"No space left on device": "the disk is full: 700 MB are needed",
    r"CERTIFICATE_VERIFY_FAILED": "the index's certificate is not trusted: check the clock, or set PIP_CERT",
    r"No matching distribution found for (?P<what>\S+)": (
        "the package index has no {what} for this Python and machine: another Python is named with PYTHON=python3.12"
    ),
}
"""What pip writes of a fault, and the sentence for it; the first one counts."""
PIP = ("-P", "-m", "pip", "install", "--disable-pip-version-check", "--progress-bar=off", "--editable")


class Progress:
    """The one line that moves on a terminal, or some lines in a log."""

    def __init__(self) -> None:
        self._moves = sys.stdout.isatty()
        self._next = 0.0

    def tell(self, text: str, now: bool = False) -> None:
        if not now and time.monotonic() < self._next:
            return
        self._next = time.monotonic() + (0.1 if self._moves else LOG_EVERY)
        sys.stdout.write(f"\r\033[K{text}" if self._moves else f"{text}\n")
        sys.stdout.flush()

    def end(self, text: str) -> None:
        self.tell(text, now=True)
        if self._moves:
            sys.stdout.write("\n")


def install(python: str, what: str) -> int:
    """Run pip, and return its exit code; if it fails, show what it wrote."""
    progress, started = Progress(), time.monotonic()
    progress.tell(f"ROS and Python packages: about {SIZE} MB to download, unless pip has kept them", now=True)
    written: list[str] = []
    packages, size = 0, 0.0
    with subprocess.Popen((python, *PIP, what), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as pip:
        for line in pip.stdout or ():
            written.append(line)
            packages += line.startswith("Collecting ")
            if found := DOWNLOADING.fullmatch(line):
                size += float(found["size"]) * UNITS[found["unit"]]
                progress.tell(f"packages found: {packages}, {size:.0f} of about {SIZE} MB")
            elif line.startswith("Installing collected packages"):
                progress.tell(f"{packages} packages, {size:.0f} MB: unpacking 500 MB", now=True)
    if pip.returncode:
        LOG.parent.mkdir(exist_ok=True)
        LOG.write_text("".join(written))
        progress.end(f"not installed: {cause(''.join(written))}")
        sys.stdout.write(f"what pip wrote is in {LOG}; run the same command again to go on\n")
    else:
        seconds = time.monotonic() - started
        progress.end(f"{packages} packages, {size:.0f} MB: installed in {seconds:.0f} s")
    return pip.returncode


def cause(written: str) -> str:
    """Return one sentence for what pip wrote, with the remedy."""
    for pattern, sentence in CAUSES.items():
        if found := re.search(pattern, written):
            return sentence.format(**found.groupdict())
    return next((line.strip() for line in reversed(written.splitlines()) if "error" in line.lower()), "pip failed")


if __name__ == "__main__":
    sys.exit(install(*sys.argv[1:]))
