"""What the installed features add, and what of it is left out: a feature that fails or takes a name stops no bridge."""

from __future__ import annotations

import logging
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from rsb_bridge.feature import API, GROUP, Feature

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class FeatureFault:
    """Something of a feature that is left out; all else of the feature works.

    Attributes:
        feature: its name.
        method: of `Feature`, that would add it; empty if it is the whole feature.
        reason: with the name that is taken, if one is, and the remedy.
    """

    feature: str
    method: str
    reason: str

    def __str__(self) -> str:
        what = f"something of its {self.method}" if self.method else "all of it"
        return f"the feature {self.feature}: {what} is left out: {self.reason}"


_faults: dict[FeatureFault, None] = {}


def feature_faults() -> tuple[FeatureFault, ...]:
    """Return what this process has left out so far; what it has not asked for yet may fail later."""
    return tuple(_faults)


def leave_out(feature: str, method: str, reason: str) -> None:
    """Note and log, once, that something of a feature is left out."""
    each = FeatureFault(feature, method, reason)
    if each not in _faults:
        _faults[each] = None
        _logger.warning("%s", each)


@contextmanager
def guarded(feature: Feature, method: str) -> Iterator[None]:
    """End work on a feature's method if it raises, and nothing else."""
    try:
        yield
    except Exception as error:  # noqa: BLE001 -- of code that is not ours, and of which a bridge must not depend
        failed(feature.name, method, error)


def failed(feature: str, method: str, error: Exception) -> None:
    """Note that a method of a feature has raised."""
    leave_out(feature, method, _failure(error))


def _failure(error: Exception) -> str:
    return f"{type(error).__name__}: {error}; update or remove it"


def leave_taken(feature: Feature, method: str, name: str, owner: str) -> None:
    """Note that a name is not given to a feature, as the core or another feature has it."""
    leave_out(feature.name, method, f"{name} is taken by {owner}: it has to be renamed there")


def added_by(
    method: str, *arguments: Any, name_of: Callable[[Any], str] | None = None, taken: Iterable[str] = ()
) -> Iterator[tuple[Feature, Any]]:
    """Yield what each feature adds by a method of `Feature`, with the feature.

    Args:
        name_of: returns the name of one, which two must not share; None if they have none.
        taken: names of the core.
    """
    owners = dict.fromkeys(taken, "the core")
    for feature in features_with(method):
        found: tuple[tuple[str, Any], ...] = ()
        with guarded(feature, method):
            found = tuple((name_of(each) if name_of else "", each) for each in getattr(feature, method)(*arguments))
        for name, each in found:
            if name in owners:
                leave_taken(feature, method, name, owners[name])
                continue
            if name_of:
                owners[name] = f"the feature {feature.name}"
            yield feature, each


def added(
    method: str, *arguments: Any, name_of: Callable[[Any], str] | None = None, taken: Iterable[str] = ()
) -> tuple[Any, ...]:
    """Return all that `added_by` finds."""
    return tuple(each for _, each in added_by(method, *arguments, name_of=name_of, taken=taken))


@cache
def installed() -> tuple[Feature, ...]:
    """Return the installed features in order of their names, but each after the features that it needs.

    One that cannot be loaded, or lacks another one that it needs, is left out.
    """
    found: dict[str, Feature] = {}
    for feature in _loaded():
        if feature.name in found:
            leave_out(feature.name, "", "another package has a feature of that name: remove one of them")
        found.setdefault(feature.name, feature)
    ordered: dict[str, Feature] = {}

    def add(feature: Feature) -> bool:
        if feature.name in ordered:
            return True
        missing = [name for name in feature.needs if name not in found or not add(found[name])]
        if missing:
            leave_out(feature.name, "", f"it needs {', '.join(missing)}: install what brings that")
            return False
        ordered[feature.name] = feature
        return True

    for _, feature in sorted(found.items()):
        add(feature)
    return tuple(ordered.values())


def _loaded() -> Iterator[Feature]:
    from importlib.metadata import entry_points  # noqa: PLC0415 -- 1.5 MB, which a console that draws pictures does without

    for entry in entry_points(group=GROUP):
        try:
            feature = entry.load()
            if not isinstance(feature, Feature) or not isinstance(getattr(feature, "name", None), str):
                raise TypeError(f"{entry.value} is no instance of Feature with a name")
            if feature.API != API:
                raise ImportError(f"it is written for version {feature.API} of features, and this is {API}")
        except Exception as error:  # noqa: BLE001 -- of code that is not ours, and of which a bridge must not depend
            leave_out(entry.name, "", _failure(error))
        else:
            yield feature


@cache
def features_with(method: str) -> tuple[Feature, ...]:
    """Return the features that override a method of `Feature`, for what is asked about each of a thousand names."""
    return tuple(each for each in installed() if getattr(type(each), method) is not getattr(Feature, method))


def feature_names() -> tuple[str, ...]:
    """Return the names of the installed features."""
    return tuple(feature.name for feature in installed())
