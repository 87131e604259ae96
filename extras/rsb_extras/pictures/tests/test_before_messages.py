"""Views before the first message that they can draw: neither a picture nor a problem, so that viewers wait."""

from __future__ import annotations

import pytest

from rsb_bridge.cdr.decoder import Items
from rsb_extras.pictures.drawing import VIEWS, TakenMessage
from rsb_extras.pictures.map_view import MapView
from rsb_extras.pictures.picture import Wish
from rsb_extras.pictures.worker import Artist, Task


@pytest.mark.parametrize("type_name", VIEWS)
def test_before_first_message_there_is_nothing_to_say(type_name: str) -> None:
    picture = Artist().do(Task(1, type_name, Wish()))
    assert picture is not None
    assert (picture.content, picture.problem) == (None, "")


def test_map_of_frames_alone_waits_for_layer() -> None:
    view = MapView()
    view.receive(TakenMessage("/tf", "tf2_msgs/msg/TFMessage", {"transforms": Items("", 0)}, 0.0))
    assert view.draw(Wish()).problem == ""
