"""The questions for pictures come whole through a control socket."""

from __future__ import annotations

from tests.control.protocol_helpers import fed

from rsb_bridge.control import protocol
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.picture import Wish


def test_questions_for_pictures_come_through_whole() -> None:
    asked = (LookAtTopics("v", ("/map", "/tf"), Wish(width=100, how="map"), "r1"), EndLook("v"))
    messages = [protocol.CommandRequest(number, command) for number, command in enumerate(asked)]
    assert fed(b"".join(map(protocol.encode, messages)), to_bridge=True, at_once=7) == messages
