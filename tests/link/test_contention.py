"""Whether a link counts as full, and what it carries."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest

from rsb_bridge.link.contention import Contention, LinkFullness

if TYPE_CHECKING:
    from rsb_bridge.context import Context


def test_the_time_without_a_link_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    clock: Any = SimpleNamespace(now=lambda: 1000.0, wall=lambda: 1000.0)
    contention = Contention(cast("Context", clock), list, list, LinkFullness(lambda *_: None))
    for second in range(4):
        contention.sending.look(1e5, second, second, full=True)
    contention.disconnected()
    contention.sending.look(1e5, 1000.0, 1000.0, full=True)
    assert contention.sending.look(1e5, 1001.0, 1001.0, full=True) == pytest.approx(1e5)
