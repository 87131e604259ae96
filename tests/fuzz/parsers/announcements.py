"""Announcements of bridges, as any node of the ROS domain may publish them (PROTOCOL.md, 5)."""

from __future__ import annotations

from tests.fuzz.editing import edit_json
from tests.fuzz.parser import Parser

from rsb_bridge.cdr.known_types import serialize_string, string_bytes
from rsb_bridge.ros.announcements import AnnouncementError, read_announcement


def _read(payload: bytes) -> None:
    assert len(string_bytes(payload)) <= len(payload)
    try:
        publishers, services = read_announcement(payload)
    except AnnouncementError:
        return
    assert all(1 <= len(gid) <= 24 and origin.via for gid, origin in publishers.items())
    assert all(origin.via for origin in services.values())
    assert len(publishers) + len(services) <= len(payload)


def _read_json(data: bytes) -> None:
    message = serialize_string(data)
    assert string_bytes(message) == data
    _read(message)


_ANNOUNCEMENT = (
    b'{"version":1,"publishers":['
    b'{"topic":"/scan","gid":"010f7800","via":["rsb_control_5e6f7a8b/scan"],"live":true},'
    b'{"topic":"/map","gid":"010f7801","via":["rsb_a_1/map","rsb_b_2/map"]}],'
    b'"services":[{"service":"/load_map","via":["rsb_control_5e6f7a8b/load_map"]}]}'
)

PARSERS = (
    Parser("announcement", _read_json, (_ANNOUNCEMENT,), edit_json),
    Parser("announcement_message", _read, (serialize_string(_ANNOUNCEMENT), b"\0\0\0\0\0\0\0\1\0")),
)
