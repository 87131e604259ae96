"""The sample sessions that this installation can read: the core alone has no Zenoh."""

from __future__ import annotations

from pathlib import Path

from rsb_bridge.installed_features import feature_names

CONFIGS = Path(__file__).parents[2] / "configs"
SAMPLES = [
    path for path in sorted(CONFIGS.glob("*.yaml")) if not path.name.startswith("zenoh-") or "zenoh" in feature_names()
]
