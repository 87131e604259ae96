"""The program, whose armings outlast a process that a busy machine lets stand still for more than a second.

As the fixture `long_lease` of tests/engine, for bridges that are processes of their own.
"""

from __future__ import annotations

import sys

from rsb_bridge.route import lease
from rsb_console.cli import main

lease.LASTS = lease.SLOW = 5.0
lease.GIVEN_UP_AFTER = 15.0
sys.exit(main())
