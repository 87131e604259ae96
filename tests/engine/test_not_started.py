"""An engine that cannot run its session: the reason is in its log, too."""

from __future__ import annotations

from pathlib import Path

import pytest

from rsb_bridge.api import EngineError
from rsb_bridge.engine import Engine
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Session
from rsb_bridge.model.snapshot import Level


def test_a_missing_key_is_in_the_log(tmp_path: Path) -> None:
    session = Session(
        name="robot1", role="client", server_ip="127.0.0.1", server_port=5, key_file="none.key", domain_id=1
    )
    engine = Engine(session, base=tmp_path)
    with pytest.raises(EngineError) as refused:
        engine.start()
    (event,) = [event for event in engine.events() if event.code == EventCode.ENGINE_NOT_STARTED]
    assert event.level is Level.ERROR
    assert event.text == str(refused.value)
    assert "none.key" in event.text
    engine.stop()
