"""`rsb-console` with another version of the wire. usage: python -m tests.system.other_version VERSION ARGUMENTS"""

import sys

from rsb_bridge.wire import preamble
from rsb_console.cli import main

if __name__ == "__main__":
    preamble.VERSION = int(sys.argv.pop(1))
    sys.exit(main())
