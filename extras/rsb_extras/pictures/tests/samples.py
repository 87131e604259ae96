"""Real ROS messages, as the worker hands them to views."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.serialization import serialize_message

from rsb_bridge.cdr.description import hash_of_text
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_extras.pictures.picture import Cells
from rsb_extras.pictures.worker import Artist, TakenSample, Task

if TYPE_CHECKING:
    from rsb_extras.pictures.drawing import Drawn
    from rsb_extras.pictures.picture import Picture, Wish

_NS = 10**9


def type_name_of(message: Any) -> str:
    package, kind, *_ = type(message).__module__.split(".")
    return f"{package}/{kind}/{type(message).__name__}"


def task(
    wish: Wish, *messages: Any, view: int = 1, topic: str = "/topic", at: float = 1000.0, every: float = 0.1
) -> Task:
    """Return a task whose messages were received one after another, beginning `at` s since the epoch."""
    samples, descriptions = [], {}
    for number, message in enumerate(messages):
        name = type_name_of(message)
        text = installed_description(name)
        assert text is not None
        descriptions[name] = name, text, hash_of_text(text)
        stamp = int((at + number * every) * _NS)
        samples.append(TakenSample(topic, name, serialize_message(message), stamp))
    type_name = samples[0].type_name if samples else ""
    return Task(view, type_name, wish, tuple(samples), len(samples), descriptions=tuple(descriptions.values()))


def drawn(wish: Wish, *messages: Any, topic: str = "/topic") -> Picture:
    """Return the picture of messages, by a worker's artist in this process."""
    picture = Artist().do(task(wish, *messages, topic=topic))
    assert picture is not None
    return picture


def cells_of(picture: Picture | Drawn) -> Cells:
    """Return the content of a picture that consists of characters."""
    assert isinstance(picture.content, Cells), picture.problem
    return picture.content
