"""The messages of a benchmark on this machine."""

from __future__ import annotations

import pytest
from tests.support import surroundings

from rsb_bridge.cdr.known_types import made_at, stamped_string
from rsb_extras.bench import measured_stream
from rsb_extras.bench.measured_stream import MeasuredArrivals


def test_leftovers_of_earlier_run_do_not_count() -> None:
    arrivals, late = MeasuredArrivals(), stamped_string(100)
    arrivals.add(late)
    assert (arrivals.count, len(arrivals.latencies)) == (1, 1)
    arrivals.reset()
    arrivals.add(late)
    arrivals.add(stamped_string(100))
    assert (arrivals.count, len(arrivals.latencies)) == (1, 1)


@pytest.mark.parametrize(
    ("size", "length"), [(0, 24), (20, 24), (24, 24), (25, 28), (26, 28), (27, 28), (28, 28), (2500, 2500)]
)
def test_length_of_message_needs_no_padding(size: int, length: int) -> None:
    message = stamped_string(size)
    # The encapsulation header and the String's length before it.
    assert len(message) == 4 + 4 + length
    assert int.from_bytes(message[4:8], "little") == length
    assert message.endswith(b"x\0")


class _Publishing:
    """A node whose publishers keep what they publish."""

    def __init__(self) -> None:
        self.published: list[bytes] = []

    def create_publisher(self, *_: object) -> _Publishing:
        return self

    @property
    def handle(self) -> _Publishing:
        return self

    def publish_raw(self, message: bytes) -> None:
        self.published.append(message)


@pytest.mark.parametrize("rate", [100_000, 1_000_000])
def test_each_message_has_own_stamp_at_every_rate(rate: int, monkeypatch: pytest.MonkeyPatch) -> None:
    surroundings.set_stdin(monkeypatch, f"send {rate} 1000 2500\n")
    node = _Publishing()
    measured_stream.talk(node, ["/topic"])
    stamps = [made_at(message) for message in node.published]
    assert len(set(stamps)) == len(stamps) == 1000
    assert stamps == sorted(stamps)
