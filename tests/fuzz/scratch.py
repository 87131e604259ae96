"""A folder for parsers that read files."""

from __future__ import annotations

import atexit
import tempfile
from functools import cache
from pathlib import Path


@cache
def scratch_folder() -> Path:
    """A folder of this process's own, gone with it."""
    folder = tempfile.TemporaryDirectory(prefix="rsb-fuzz-")
    atexit.register(folder.cleanup)
    return Path(folder.name)
