"""Rules on the bounds of what is kept in memory, and advice on them."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Range, Wording
from rsb_extras.recording import RECORD, record_limits
from rsb_extras.recording.mcap_file import McapText

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.feature_api import Session

SECONDS = Range(1, 3600)  # a round figure
MEGABYTES = Range(1, 256)
"""MiB. A round figure: as much again is used while a recording is written."""


class RecordText(Wording):
    OUT_OF_RANGE = "{value:g} is out of range: {range}"


def problems(session: Session) -> Iterator[tuple[str, str]]:
    """Yield the mistakes, as `Feature.problems`."""
    limits = record_limits(session)
    if limits is None:
        return
    for name, allowed in (("seconds", SECONDS), ("megabytes", MEGABYTES)):
        value = getattr(limits, name)
        if value not in allowed:
            yield f"{RECORD.name}.{name}", RecordText.OUT_OF_RANGE(value=value, range=allowed)


def advice(session: Session) -> Iterator[tuple[str, str]]:
    """Yield advice, as `Feature.advice`."""
    if record_limits(session) is not None and importlib.util.find_spec("mcap") is None:
        yield RECORD.name, McapText.NOT_INSTALLED()
