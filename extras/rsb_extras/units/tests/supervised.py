"""A process that is supervised by a script with a pid file, as a stand-in for systemd, which needs a machine."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from rsb_bridge.feature import MAY
from rsb_bridge.model.session import session_keys
from rsb_extras.units import UNITS, ListedUnit

SCRIPT = """\
#!/bin/sh
# $1: a folder with pid, log and ran; $2: what to do
cd "$1" || exit 9
running() { [ -f pid ] && kill -0 "$(cat pid)" 2>/dev/null; }
case $2 in
status) if running; then exit 0; elif [ -f pid ]; then exit 1; else exit 3; fi ;;
log) tail -n 50 log ;;
*)
  echo "$2" >> ran
  case $2 in
  stop|restart) if running; then kill "$(cat pid)"; while running; do sleep 0.01; done; fi; rm -f pid ;;
  esac
  case $2 in
  start|restart)
    if [ -f broken ]; then echo "cannot open /dev/lidar" >> log; echo "no device" >&2; exit 7; fi
    setsid sleep 1000 </dev/null >/dev/null 2>&1 &
    echo $! > pid; echo "started" >> log ;;
  esac
esac
exit 0
"""


def may(*names: str) -> Any:
    """Return the value of `may` that gives the right to ask for units."""
    return session_keys()[MAY].type(units=names)


class Supervised:
    """A unit's folder and its commands.

    Attributes:
        unit: with all actions.
    """

    def __init__(self, folder: Path, **changes: Any) -> None:
        self.folder = folder
        folder.mkdir()
        script = folder / "supervise"
        script.write_text(SCRIPT)
        script.chmod(0o755)
        words = {each: (str(script), str(folder), each) for each in ("start", "stop", "restart", "status", "log")}
        self.unit = ListedUnit(**{**words, "timeout": 60.0, **changes})

    @property
    def ran(self) -> list[str]:
        """The actions that were carried out."""
        path = self.folder / "ran"
        return path.read_text().split() if path.exists() else []

    @property
    def pid(self) -> int:
        """The supervised process's number, or 0 without one."""
        path = self.folder / "pid"
        return int(path.read_text()) if path.exists() else 0

    def breaks(self) -> None:
        """Have each further start fail."""
        (self.folder / "broken").touch()

    def close(self) -> None:
        if self.pid:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)


def waiting(folder: Path) -> tuple[str, ...]:
    """Return a command that notes its start, and ends once there is a file `go`."""
    (folder / "ran").touch()
    program = (
        "import pathlib, sys, time; folder = pathlib.Path(sys.argv[1])\n"
        "with (folder / 'ran').open('a') as ran: ran.write('waits\\n')\n"
        "while not (folder / 'go').exists(): time.sleep(0.01)"
    )
    return sys.executable, "-c", program, str(folder)


def has(*supervised: tuple[str, Supervised], **others: Any) -> dict[str, Any]:
    """Return the features of a session that has units by these names."""
    return {UNITS.name: {name: each.unit for name, each in supervised}, **others}
