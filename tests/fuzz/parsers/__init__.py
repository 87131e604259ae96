"""The parsers, also of features: a module for each family, which lists them in `PARSERS`."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.fuzz.parser import Parser

FAMILIES = (
    "preamble",
    "control_messages",
    "data_frames",
    "datagrams",
    "descriptions",
    "fields",
    "session_files",
    "control_socket",
    "operators",
    "announcements",
    "bluetooth",
)


def load_parsers() -> dict[str, Parser]:
    """All parsers by their names. What they read with is imported only now, so that it can be instrumented."""
    features = Path(__file__).parents[3].glob("extras/rsb_extras/*/tests/fuzzed_parsers.py")
    names = [f"tests.fuzz.parsers.{family}" for family in FAMILIES]
    names += [f"rsb_extras.{path.parts[-3]}.tests.{path.stem}" for path in sorted(features)]
    modules = [importlib.import_module(name) for name in names]
    return {parser.name: parser for module in modules for parser in module.PARSERS}
