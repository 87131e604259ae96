"""What stands in the source of the packages that draw screens."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import rsb_console
import rsb_extras

if TYPE_CHECKING:
    from collections.abc import Callable

FOLDERS = [Path(str(package.__file__)).parent for package in (rsb_console, rsb_extras)]


def found_in(folder: Path, look: Callable[[str], list[str]]) -> dict[Path, list[str]]:
    """What `look` finds in each module of a folder, without its tests, where it finds anything."""
    files = (path for path in folder.rglob("*.py") if "tests" not in path.parts)
    sources = {path: path.read_text(encoding="utf-8") for path in files}
    assert sources
    return {path: found for path, source in sources.items() if (found := look(source))}
