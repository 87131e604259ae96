"""A route sends again, waits or closes when something that carries it is lost: by one table, for each kind of route."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.offline import half_of

from rsb_bridge.model import fates
from rsb_bridge.model.fates import ARM_REQUIRED, BEST_EFFORT, RELIABLE, Fate, Lost
from rsb_bridge.model.keep import Keep
from rsb_bridge.model.qos import parse_qos
from rsb_bridge.model.session import Topic
from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.calls.provider import Provider
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.model.fates import Fates

_AGAIN, _WAITS, _CLOSES, _LOSES = Fate.SENDS_AGAIN, Fate.WAITS, Fate.CLOSES, Fate.LOSES


@pytest.mark.parametrize(
    ("row", "datagram", "stream", "connection", "association"),
    [
        (RELIABLE, _AGAIN, _AGAIN, _AGAIN, _CLOSES),
        (BEST_EFFORT, _LOSES, _WAITS, _WAITS, _CLOSES),
        (ARM_REQUIRED, _LOSES, _CLOSES, _CLOSES, _CLOSES),
    ],
    ids=("reliable", "best effort", "has to be armed"),
)
def test_what_is_lost_decides(row: Fates, datagram: Fate, stream: Fate, connection: Fate, association: Fate) -> None:
    assert [row[lost] for lost in Lost] == [datagram, stream, connection, association]


_TEXTS = {"docs/outages.md": (Path(__file__).parents[2] / "docs/outages.md").read_text(), "docstring": fates.__doc__}


@pytest.mark.parametrize("text", _TEXTS)
def test_it_is_written_as_it_is(text: str) -> None:
    """A page for operators, and the module's docstring."""
    lines = [line for line in (_TEXTS[text] or "").splitlines() if line.startswith("|")]
    cells = [tuple(map(str.strip, line.strip("|").split("|"))) for line in lines]
    rows = {"reliable": RELIABLE, "best effort": BEST_EFFORT, "has to be armed": ARM_REQUIRED}
    assert cells[0][1:] == tuple(lost.value for lost in Lost)
    assert cells[2:] == [(name, *(fate.value for fate in row.values())) for name, row in rows.items()]


_KEEP = Keep(60.0)


@pytest.mark.parametrize(
    ("fields", "qos", "reliable"),
    [
        ({}, None, True),
        ({}, "default", True),
        ({}, "latched", True),
        ({}, "sensor_data", False),
        ({"keep": _KEEP}, "sensor_data", True),
        ({"protocol": "udp"}, "default", True),
        ({"protocol": "udp"}, "sensor_data", False),
        ({"protocol": "udp", "keep": _KEEP}, "sensor_data", False),
    ],
)
@pytest.mark.parametrize("kind", [Sender, Receiver])
def test_topic_is_what_its_qos_is(
    kind: type[Sender | Receiver], fields: dict[str, Any], qos: str | None, reliable: bool,
    make_context: Callable[..., Context],
) -> None:  # fmt: skip
    half = half_of(kind, make_context(), Topic("/chat", "transmit", **fields))
    half.flow.qos, by_datagrams = parse_qos(qos or "auto"), "protocol" in fields
    assert half.route.fates is (RELIABLE if reliable else BEST_EFFORT)
    assert half.route.lossy is (by_datagrams and not reliable)
    half.route.arming.required = True
    assert half.route.fates is ARM_REQUIRED
    assert half.route.lossy is by_datagrams


@pytest.mark.parametrize("kind", [Caller, Provider])
@pytest.mark.parametrize("calls", ["service", "action"])
def test_calls_are_reliable(kind: type[Caller | Provider], calls: Any, make_context: Callable[..., Context]) -> None:
    route = half_of(kind, make_context(), Topic("/lamp", "transmit", kind=calls)).route
    assert route.fates is RELIABLE
    route.arming.required = True
    assert route.fates is ARM_REQUIRED
