"""The option of `record` that keeps a stretch of the ring on disk instead."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from rsb_console.feature_console import subcommand

if TYPE_CHECKING:
    from collections.abc import Sequence

_HELP = "instead, keep what the ring on disk (record.disk) has of before, and what comes after, with a note"


class _Keep(argparse.Action):
    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        namespace.keep = values
        namespace.command = subcommand("rsb_extras.disk_ring.keep_command:keep")


def add_keep(record: argparse.ArgumentParser) -> None:
    """Add it to the parser of `record`."""
    record.add_argument("--keep", action=_Keep, metavar="NOTE", default=None, help=_HELP)
