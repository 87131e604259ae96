"""No message, however damaged, makes a view fail in any other way than in words, or draw what cannot be shown."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from tests.support.filled import filled
from tests.support.wording import has_text

from rsb_extras.pictures.picture import Picture, Wish, decode_picture, encode_picture
from rsb_extras.pictures.tests.hostile_helpers import INSTALLED, draw, kind
from rsb_extras.pictures.tests.samples import task
from rsb_extras.pictures.worker import Undrawable


def check(picture: Picture, wish: Wish) -> None:
    assert not has_text(picture.problem, Undrawable.FAILED)
    assert decode_picture(encode_picture(picture)) == picture
    rows = getattr(picture.content, "rows", ())
    assert len(rows) <= wish.height
    assert all(len(row) <= wish.width for row in rows)


WISHES = st.builds(
    Wish, width=st.integers(1, 60), height=st.integers(1, 30), zoom=st.floats(0.01, 1000), x=st.floats(-9, 9),
    y=st.floats(-9, 9), tilt=st.floats(0, 90), colour=st.sampled_from(["height", "intensity"]),
    how=st.sampled_from(["", "", "plot", "tree", "map", "fields"]), match=st.sampled_from(["", "", "a"]),
)  # fmt: skip


def test_usual_views_can_be_tested_here() -> None:
    assert len(INSTALLED) > 20


@pytest.mark.parametrize("type_name", INSTALLED)
@settings(suppress_health_check=list(HealthCheck), max_examples=settings().max_examples // 2)
@given(wish=WISHES, data=st.data())
def test_damaged_messages(type_name: str, wish: Wish, data: st.DataObject) -> None:
    message = filled(kind(type_name)) if data.draw(st.booleans()) else kind(type_name)()
    payload = bytearray(serialize_message(message))
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(4, max(4, len(payload) - 1)))
        payload[at : at + data.draw(st.integers(1, 8))] = data.draw(st.binary(max_size=12))
    check(draw(task(wish, message), damaged=bytes(payload)), wish)
