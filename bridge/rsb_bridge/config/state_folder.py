"""The folder in which bridges of this user, or of systemd, keep what outlives them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

SERVICES = Path("/var/lib/rsb-console")
"""The folder of bridges that systemd runs, `StateDirectory=` of their unit."""


def state_folder(environ: Mapping[str, str]) -> Path:
    """Return the folder that this process writes to.

    systemd's own for a service (``$STATE_DIRECTORY``), else ``$XDG_STATE_HOME/rsb-console``, else
    ``~/.local/state/rsb-console``.
    """
    if service := environ.get("STATE_DIRECTORY", "").partition(":")[0]:  # a unit may have several
        return Path(service)
    base = environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path(os.path.expanduser("~/.local/state"))) / "rsb-console"  # noqa: PTH111 -- never fails


def searched_folders(environ: Mapping[str, str]) -> list[Path]:
    """Return the folders in which this user may find what bridges have kept."""
    return list(dict.fromkeys((state_folder(environ), SERVICES)))
