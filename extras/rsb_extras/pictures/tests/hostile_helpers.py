"""Helpers of `test_hostile` and others."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_extras.pictures.drawing import VIEWS
from rsb_extras.pictures.worker import Artist, Task

if TYPE_CHECKING:
    from rsb_extras.pictures.picture import Picture

INSTALLED = sorted(name for name in VIEWS if "/" in name and installed_description(name) is not None)


def kind(type_name: str) -> Any:
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def draw(wanted: Task, *, damaged: bytes | None = None, topic: str = "/t") -> Picture:
    sample = wanted.samples[0]
    changed = msgspec.structs.replace(sample, topic=topic, **({} if damaged is None else {"payload": damaged}))
    picture = Artist().do(msgspec.structs.replace(wanted, samples=(changed,)))
    assert picture is not None
    return picture
