"""The QoS of publishers, as rosbag2 writes it beside a topic (``offered_qos_profiles``)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml

from rsb_bridge.feature_api import Qos

if TYPE_CHECKING:
    from collections.abc import Mapping

_LONGEST = 64 << 10  # characters of one channel's QoS: 200 publishers. To parse as many takes 0.1 to 0.5 s
RELIABLE: dict[object, bool] = {"reliable": True, 1: True, "best_effort": False, 2: False}
LATCHED: dict[object, bool] = {"transient_local": True, 1: True, "volatile": False, 2: False}
"""Policies by their names (rosbag2 since Jazzy) and numbers (before)."""
_MOST_LATCHED = 1000  # messages that a late joiner gets. A round figure
_DEPTH = 999
"""Messages that wait for subscriptions: 1 s at 1 kHz. DDS takes memory only for those that wait. With 1000, the writer
would not be prompt (`rsb_bridge.ros.participant`): 3 of 300 messages of 1 MB arrived."""
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def parsed_profiles(profiles: str) -> list[dict[Any, Any]]:
    """Parse the profiles of a channel, one for each publisher; what is not understood is left out."""
    if len(profiles) > _LONGEST or "&" in profiles:  # no profile has anchors, a few lines of which may fill the memory
        return []
    try:
        parsed = yaml.load(profiles, _Loader)  # noqa: S506 -- the safe one
    except (yaml.YAMLError, ValueError, RecursionError):  # ValueError: a date that is none
        return []
    return [each for each in parsed if isinstance(each, dict)] if isinstance(parsed, list) else []


def policy(known: Mapping[object, bool], value: object) -> bool | None:
    """Return a policy of a profile, or None if it is unknown."""
    return known.get(value) if isinstance(value, str | int) else None


def played_qos(profiles: str) -> Qos:
    """Return the QoS of one publisher in place of those that were recorded, to which all their subscriptions match.

    A late joiner gets as many messages as from all of them. Deadlines and leases are left out: a player that pauses
    keeps none.
    """
    found = parsed_profiles(profiles)
    if not found:
        return Qos(depth=_DEPTH)
    is_reliable = any(policy(RELIABLE, each.get("reliability")) is not False for each in found)
    if not any(policy(LATCHED, each.get("durability")) for each in found):
        return Qos(reliability="reliable" if is_reliable else "best_effort", depth=_DEPTH)
    kept = sum(_depth(each) for each in found)
    return Qos(durability="transient_local", depth=min(kept, _MOST_LATCHED))


def _depth(profile: Mapping[Any, Any]) -> int:
    if profile.get("history") in ("keep_all", 2):
        return _MOST_LATCHED
    depth = profile.get("depth")
    return depth if isinstance(depth, int) and 0 < depth < _MOST_LATCHED else 1  # 0: DDS tells nobody
