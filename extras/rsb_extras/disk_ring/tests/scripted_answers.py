"""The stretch of the robot that `tests.console.scripted` plays."""

from __future__ import annotations

import os

from rsb_extras.disk_ring.keep_stretch import KeepStretch, StretchAnswer

KEEPING = StretchAnswer("/var/lib/rsb-console/recordings/robot1-20260102-030405-note", os.uname().nodename, 60.0, 30.0)
ANSWERS = {KeepStretch: lambda _: KEEPING}
