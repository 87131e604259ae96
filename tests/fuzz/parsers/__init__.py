"""The parsers, a module for each family. A module's `PARSERS` are what is fuzzed."""

from __future__ import annotations

import importlib
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
    "kept_files",
    "control_socket",
    "operators",
    "announcements",
    "pictures",
    "bluetooth",
)


def load_parsers() -> dict[str, Parser]:
    """All parsers by their names. What they read with is imported only now, so that it can be instrumented."""
    modules = [importlib.import_module(f"tests.fuzz.parsers.{family}") for family in FAMILIES]
    return {parser.name: parser for module in modules for parser in module.PARSERS}
