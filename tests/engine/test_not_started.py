"""An engine that cannot run its session: the reason is in its log, too."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from tests.support import replaced

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


def test_engines_load_their_decoders_one_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """msgspec has no lock for what it keeps of their types."""
    loading, most = 0, 0

    def load() -> None:
        nonlocal loading, most
        loading += 1
        most = max(most, loading)
        time.sleep(0.05)
        loading -= 1

    def start() -> None:
        with pytest.raises(EngineError):
            Engine(session, base=tmp_path).start()

    replaced.DECODERS.set(monkeypatch, load)
    session = Session(name="a", role="client", server_ip="127.0.0.1", server_port=5, key_file="none.key", domain_id=1)
    with ThreadPoolExecutor(4) as threads:
        for started in [threads.submit(start) for _ in range(4)]:
            started.result()
    assert most == 1
