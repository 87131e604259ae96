"""Helpers of `test_client` and others."""

from __future__ import annotations

from pathlib import Path

import pytest

from rsb_bridge.config.keys import write_key

TEXT = """\
# the fleet
name: pc
role: server
server_ip: 10.0.0.20
server_port: 49152
clients:
  - {name: robot1, key_file: robot1.key}   # the first
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Write a server's session file, and its client's key."""
    path = tmp_path / "pc.yaml"
    path.write_text(TEXT)
    write_key(tmp_path / "robot1.key")
    return path
