"""Helpers of `test_bytes` and others."""

from __future__ import annotations

from typing import Any

from rsb_bridge.model.type_names import SHORT_NAMES
from rsb_bridge.ros.native.typesupport import installed_class

INSTALLED: dict[str, Any] = {name: found for name in SHORT_NAMES.values() if (found := installed_class(name))}
