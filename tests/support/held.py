"""Counts the entries of an object's tables, without their names."""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Iterator, Mapping, Set

_CONTAINERS = (Mapping, Set, list, deque, array, bytearray)


def held_by(thing: object) -> int:
    """Return the number of entries in all tables of an object, plus the bytes in its buffers.

    Parts of the object count if their classes come from its own class's module.
    """
    return sum(map(len, _containers(thing, type(thing).__module__, set())))


def _containers(thing: object, module: str, seen: set[int]) -> Iterator[list[object] | bytearray]:
    if id(thing) in seen:
        return
    seen.add(id(thing))
    inner: list[object] = []
    if isinstance(thing, bytearray):
        yield thing
    elif isinstance(thing, _CONTAINERS):
        inner = list(thing.values()) if isinstance(thing, Mapping) else list(thing)
        yield inner
    elif type(thing).__module__ == module:
        slots = [name for each in type(thing).__mro__ for name in getattr(each, "__slots__", ())]
        names = {*getattr(thing, "__dict__", ()), *slots}
        inner = [getattr(thing, name) for name in names if hasattr(thing, name)]
    for each in inner:
        yield from _containers(each, module, seen)
