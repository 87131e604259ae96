"""A Python module in a process that ends when its parent ends, even if that is killed.

The parent holds one end of a pipe and never writes to it. When the parent ends, the kernel closes that end. The child's
standard output is for the module's own lines, which the parent reads.
"""

from __future__ import annotations

import os
import runpy
import signal
import subprocess
import sys
import threading
import time
import weakref
from typing import Any

from rsb_bridge.model.text import keep_output_clean

_ENDS_WITHIN = 8.0
"""Seconds from the parent's end until a child that still runs, such as one that ignores SIGTERM, is killed. A round
figure: nothing was measured."""


class ChildProcess(subprocess.Popen[str]):
    """Runs a module as ``python -P -m`` does: modules in the working folder are not found.

    Args:
        options: for `subprocess.Popen`.
    """

    def __init__(self, module: str, *arguments: str, **options: Any) -> None:
        watched, held = os.pipe()
        # If nobody has this object any more, its process ends, as it does with the parent.
        weakref.finalize(self, os.close, held)
        try:
            command = [sys.executable, "-P", "-m", __name__, str(watched), module, *arguments]
            super().__init__(command, text=True, pass_fds=(watched,), **options)
        finally:
            os.close(watched)


def _end_with_parent(watched: int) -> None:
    os.read(watched, 1)  # returns at the end of the pipe, which is the end of the parent
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_ENDS_WITHIN)
    os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    parents_end, name, *rest = sys.argv[1:]
    os.set_inheritable(int(parents_end), False)
    threading.Thread(target=_end_with_parent, args=(int(parents_end),), name="parent", daemon=True).start()
    keep_output_clean()
    sys.argv = [name, *rest]
    runpy.run_module(name, run_name="__main__", alter_sys=True)
