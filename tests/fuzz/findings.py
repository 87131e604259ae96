"""The findings of fuzzing: one input of each kind, in a file, with the command that repeats it."""

from __future__ import annotations

import hashlib
import traceback
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from tests.fuzz.parser import Parser

_LENGTH = 12


class Findings:
    """Keeps the first input of each kind of failure, so that fuzzing can go on.

    Args:
        folder: that they are written to; it may be missing.
    """

    def __init__(self, folder: Path, parser: Parser) -> None:
        self._folder = folder
        self._parser = parser
        self._kinds: set[str] = set()

    def read(self, data: bytes) -> None:
        try:
            self._parser.read(data)
        except Exception as error:  # noqa: BLE001 -- every exception is a finding
            kind = _kind(error)
            if kind in self._kinds:
                return
            self._kinds.add(kind)
            self._folder.mkdir(parents=True, exist_ok=True)
            name = f"{self._parser.name}-{hashlib.sha256(kind.encode()).hexdigest()[:_LENGTH]}"
            (self._folder / name).write_bytes(data)
            (self._folder / f"{name}.txt").write_text("".join(traceback.format_exception(error)), encoding="utf-8")


def inputs_in(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*-*") if path.suffix != ".txt") if folder.is_dir() else []


def _kind(error: BaseException) -> str:
    """Return where it was raised: inputs that fail there for one reason are one finding."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} {last.filename}:{last.lineno}"
