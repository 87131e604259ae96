"""A route's last error and its time."""

from __future__ import annotations

from rsb_bridge.model.codes import EventCode
from rsb_bridge.route.notices import Notices


def test_last_error_has_time_of_its_last_occurrence() -> None:
    now, said = [100.0], list[str]()
    notices = Notices(lambda level, code, text: said.append(text), lambda: now[0])
    notices.error(EventCode.ROUTE_CHANNEL_LOST, "gone")
    now[0] = 160.0
    notices.message_error(EventCode.ROUTE_TOO_LARGE, "too large")
    now[0] = 170.0
    notices.message_error(EventCode.ROUTE_TOO_LARGE, "too large")
    assert (notices.last_error, notices.last_error_at) == ("too large", 170.0)
    assert said == ["gone", "too large"]
