"""A longer lease for tests of other things: a busy machine may stand still for more than a second."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support import constants

if TYPE_CHECKING:
    import pytest


def lengthen_lease(patch: pytest.MonkeyPatch) -> None:
    # Not more than 5: a disarm waits for so long where the other side does not answer.
    constants.LEASE_LASTS.set(patch, 5.0)
    constants.LEASE_SLOW.set(patch, 5.0)
    constants.LEASE_GIVEN_UP_AFTER.set(patch, 15.0)
