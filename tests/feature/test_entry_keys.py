"""Keys that a feature gives to entries: in files, the form, commands, the engine and on the other side of the link."""

from __future__ import annotations

import os
import subprocess
import sys
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
PLACE = EntryKey("place", str, "", "Place", "Where its sensor is.", of_peer=True)


class Keys(Feature):
    name = "keys"

    def topic_keys(self):
        return LOW, HIGH, FRAGILE, PLACE

    def topic_problems(self, topic):
        if (LOW.of(topic) or 0) > HIGH.of(topic):
            yield "band_low", "band_low is above band_high: lower it"


FEATURE = Keys()
"""


def test_keys_of_entries_work(tmp_path: Path) -> None:
    (tmp_path / "rsb_keys.py").write_text(_FEATURE)
    describe(tmp_path, "rsb-keys", "keys = rsb_keys:FEATURE\n")
    assert "15 passed" in passed(tmp_path, "keys_inside.py")


_MANY = """
from rsb_bridge.feature import EntryKey, Feature


class Many(Feature):
    name = "many"

    def topic_keys(self):
        return [EntryKey(f"key_{n}", bool, False, "Key", "One of many.", of_peer=n != 5) for n in range(34)]


FEATURE = Many()
"""
_FOUND = """
from rsb_bridge.installed_features import feature_faults
from rsb_bridge.model.topic_keys import ADDED_KEYS
print(sum(name.startswith("key_") for name in ADDED_KEYS), *feature_faults())
"""


def test_key_beyond_what_crosses_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "rsb_many.py").write_text(_MANY)
    describe(tmp_path, "rsb-many", "many = rsb_many:FEATURE\n")
    environ = os.environ | {"PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"}
    program = [sys.executable, "-c", _FOUND]
    found = subprocess.run(program, env=environ, capture_output=True, text=True, timeout=180, check=True).stdout
    count, _, line = found.partition(" ")
    assert int(count) == 33
    assert "the feature many: something of its topic_keys is left out: key_33: the other side gets at most 32" in line
