"""``python -m rsb_console`` is ``rsb-console``."""

import sys

from rsb_console.cli import main

sys.exit(main())
