"""Changes of nodes as they cross a link."""

from __future__ import annotations

from typing import Any

import msgspec
import zstandard


def packed(changes: Any) -> bytes:
    return zstandard.compress(msgspec.msgpack.encode(changes))
