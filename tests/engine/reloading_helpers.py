"""Helpers of `test_reloading` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.config.session_file import save

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.codes import EventCode
    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import Reloaded


class Edited:
    """An engine whose session file is edited."""

    def __init__(self, engine: Engine, path: Path) -> None:
        self.engine = engine
        self.path = path
        self.session: Session = engine.session
        save(self.session, path)
        engine.use_file(path)

    def reload(self, *, dry_run: bool = False, **changes: Any) -> Reloaded:
        """Change the file, and have it read again."""
        self.session = msgspec.structs.replace(self.session, **changes)
        save(self.session, self.path)
        return self.engine.reload(dry_run=dry_run).result(60)


def codes(engine: Engine, code: EventCode) -> list[str]:
    return [event.text for event in engine.events() if event.code == code]
