"""Names of the program that tests read or replace.

`constants` and `replaced` name each of them once, so that a rename in the program changes one line here.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from operator import attrgetter
from typing import Any, NamedTuple

import pytest


class Place(NamedTuple):
    module: str
    name: str
    """A name of the module, or `Class.name`."""

    @property
    def value(self) -> Any:
        return attrgetter(self.name)(import_module(self.module))

    def set(self, patch: pytest.MonkeyPatch, value: object) -> None:
        """Set it until `patch` undoes its changes."""
        *owner, name = self.name.split(".")
        module = import_module(self.module)
        patch.setattr(attrgetter(*owner)(module) if owner else module, name, value)

    @contextmanager
    def during(self, value: object) -> Iterator[None]:
        """Set it for the time of a `with` block."""
        with pytest.MonkeyPatch.context() as patch:
            self.set(patch, value)
            yield
