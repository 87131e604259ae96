"""Lengths of all tables of an engine, by their path of attributes.

It finds every table that can be reached from the engine, so a new table that is never cleared shows without being
listed.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any

_OWN = ("rsb_bridge.", "tests.simulation.engine_host")
_NOT_HELD = (asyncio.Future, asyncio.AbstractEventLoop, type)


def tables(root: object, name: str = "engine") -> dict[str, int]:
    """Return the length of each table, by its path from `root`; all elements of a table share one path."""
    found: dict[str, int] = {}
    seen: set[int] = set()
    waiting: deque[tuple[str, object]] = deque([(name, root)])
    while waiting:
        way, each = waiting.popleft()
        if id(each) in seen or isinstance(each, _NOT_HELD):
            continue
        seen.add(id(each))
        if isinstance(each, deque) and each.maxlen is not None:
            continue  # it bounds itself
        if isinstance(each, (dict, list, tuple, set, frozenset, deque)):
            if not isinstance(each, tuple):
                found[way] = max(found.get(way, 0), len(each))
            waiting.extend((f"{way}[]", element) for element in _elements(each) if _is_own(element))
        elif isinstance(each, (bytearray,)):
            found[way] = max(found.get(way, 0), len(each) // 1000)
        else:
            waiting.extend((f"{way}.{attribute}", value) for attribute, value in _attributes(each))
    return found


def _elements(table: Any) -> Iterable[object]:
    return [*table.keys(), *table.values()] if isinstance(table, dict) else table


def _is_own(each: object) -> bool:
    return isinstance(each, (dict, list, set, deque, tuple, bytearray)) or type(each).__module__.startswith(_OWN)


def _attributes(each: object) -> Iterator[tuple[str, object]]:
    if not type(each).__module__.startswith(_OWN):
        return
    yield from getattr(each, "__dict__", {}).items()
    for kind in type(each).__mro__:
        for slot in getattr(kind, "__slots__", ()):
            if not slot.startswith("__") and hasattr(each, slot):
                yield slot, getattr(each, slot)
