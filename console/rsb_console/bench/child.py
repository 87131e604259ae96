"""Runs a module as ``python -m`` does, in a process that ends with its parent: ``... MODULE ARGUMENT...``."""

from __future__ import annotations

import ctypes
import os
import runpy
import signal
import sys

_PR_SET_PDEATHSIG = 1  # prctl(2)

if __name__ == "__main__":
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    parent, module, *arguments = sys.argv[1:]
    if os.getppid() != int(parent):  # it has ended meanwhile
        sys.exit(1)
    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name="__main__", alter_sys=True)
