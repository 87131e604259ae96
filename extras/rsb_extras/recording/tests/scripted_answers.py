"""The recording of the robot that `tests.console.scripted` plays."""

from __future__ import annotations

import os

from rsb_extras.recording.keep_last import KeepLast, KeptRecording

KEPT = KeptRecording(
    "/var/lib/rsb-console/recordings/robot1-20260102-030405.mcap", os.uname().nodename, 9_876, 12, 30.0, 8_400_000
)
ANSWERS = {KeepLast: lambda _: KEPT}
