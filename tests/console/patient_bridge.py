"""The program with the long lease of tests/engine/conftest.py, for bridges that are processes of their own."""

from __future__ import annotations

import sys

from tests.support.long_lease import TIMES

from rsb_bridge.route import lease
from rsb_console.cli import main

for name, seconds in TIMES.items():
    setattr(lease, name, seconds)
sys.exit(main())
