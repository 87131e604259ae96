"""Variables of the environment that libraries of ROS read once, while they join a domain."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, MutableMapping


@contextmanager
def with_variables(environment: MutableMapping[str, str], variables: Mapping[str, str | None]) -> Iterator[None]:
    """Set variables, or unset those that are None, for a while: children of this process inherit what stays."""
    before = {name: environment.get(name) for name in variables}
    _set(environment, variables)
    try:
        yield
    finally:
        _set(environment, before)


def _set(environment: MutableMapping[str, str], variables: Mapping[str, str | None]) -> None:
    for name, value in variables.items():
        if value is None:
            environment.pop(name, None)
        else:
            environment[name] = value
