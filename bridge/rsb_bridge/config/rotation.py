"""Keys that are being replaced: two are valid for a client, until the old one is given up."""

from __future__ import annotations

import time
from itertools import chain
from typing import TYPE_CHECKING

from rsb_bridge.config.keys import Key, fingerprint
from rsb_bridge.model.text import plural

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_DAY = 86400.0
_LONG = 7 * _DAY
"""s that two keys may be valid: whoever has stolen the old one may use it until then."""
_SPANS = ((_DAY, "day"), (3600.0, "hour"), (60.0, "minute"))


def key_warnings(keys: Mapping[str, tuple[Key, ...]], now: float) -> Iterator[str]:
    """What operators should know of the keys that are valid for each client.

    Args:
        keys: by client's name, the next one last.
        now: s since the epoch.
    """
    yield from dict.fromkeys(chain.from_iterable(key.warnings for valid in keys.values() for key in valid))
    for name, valid in keys.items():
        for following in valid[1:]:
            yield from _of_rotation(name, valid[0], following, now)


def _of_rotation(name: str, current: Key, following: Key, now: float) -> Iterator[str]:
    finish = f"`rsb-console client rekey {name} --finish`"
    if following == current:
        yield f"{name}: key_file and next_key_file hold the same key, {fingerprint(current)}: {finish} ends that"
    elif now - following.written > _LONG:
        yield (
            f"{name}: two keys have been valid since {written(following, now)}, and the old one still opens a link: "
            f"once the robot has the new one, {finish}"
        )


def written(key: Key, now: float) -> str:
    """When a key's file was written: ``2026-11-18 14:03 (3 days ago)``."""
    return f"{time.strftime('%Y-%m-%d %H:%M', time.localtime(key.written))} ({_ago(now - key.written)})"


def _ago(seconds: float) -> str:
    if seconds < -60:
        return "in the future: is the clock right?"
    for size, unit in _SPANS:
        if seconds >= size:
            count = int(seconds // size)
            return f"{count} {plural(count, unit)} ago"
    return "just now"
