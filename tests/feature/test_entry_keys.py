"""Keys that a feature gives to entries: in files, the form, commands, the engine and on the other side of the link."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.feature.own_process import describe, passed

if TYPE_CHECKING:
    from pathlib import Path

_FEATURE = """
from rsb_bridge.feature import EntryKey, Feature

LOW = EntryKey(
    "band_low", float, None, "Lowest rate", "Hz.", unit="Hz", limits=(0, 1000), kinds="topics", of_peer=True
)
HIGH = EntryKey("band_high", float, 1000.0, "Highest rate", "Hz.", unit="Hz", limits=(0, 1000), kinds="topics")
FRAGILE = EntryKey("fragile", bool, False, "Fragile", "Whether its sensor may break.")


class Keys(Feature):
    name = "keys"

    def topic_keys(self):
        return LOW, HIGH, FRAGILE

    def topic_problems(self, topic):
        if (LOW.of(topic) or 0) > HIGH.of(topic):
            yield "band_low", "band_low is above band_high: lower it"


FEATURE = Keys()
"""


def test_keys_of_entries_work(tmp_path: Path) -> None:
    (tmp_path / "rsb_keys.py").write_text(_FEATURE)
    describe(tmp_path, "rsb-keys", "keys = rsb_keys:FEATURE\n")
    assert "12 passed" in passed(tmp_path, "keys_inside.py")
