"""The adapters are unplugged. That ends the machine's use, so the module runs last."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

from rsb_bridge.bluetooth import hci
from rsb_bridge.bluetooth.scan import ScanProblem, scan
from rsb_console.command.bt_scan import run_bt_scan

from .conftest import wait_until


def test_no_adapter_says_so() -> None:
    assert len(hci.adapters()) == 2
    (controllers,) = [
        int(path.parent.name) for path in Path("/proc").glob("[0-9]*/comm") if path.read_text() == "btvirt\n"
    ]
    os.kill(controllers, signal.SIGKILL)
    wait_until(lambda: not hci.adapters(), "both are unplugged")
    found = asyncio.run(scan())
    assert found.adapters == ()
    assert found.problems == (ScanProblem.NO_ADAPTER(),)
    assert run_bt_scan(None, as_json=False) == 1
