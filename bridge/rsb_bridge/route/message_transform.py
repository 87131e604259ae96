"""Changes of a route's messages on their way in, which features make (`rsb_bridge.link.extension.Extension`).

A message is changed after it is unpacked and checked, and before ROS, an operator or a recording gets it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.installed_features import failed

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from rsb_bridge.model.verdict import Verdict

_FAILS = "the feature {feature} cannot change its messages: see what rsb-console doctor says of it"


class TransformError(ValueError):
    """A message cannot be changed as its session asks, so that it is not published; the text has the remedy."""


class MessageTransform:
    """A change of one route's messages. A subclass overrides `change`.

    Two that are equal change each message alike. While a route is open, another one takes effect at once; a latched
    topic is opened again, so that late joiners get no message that was changed otherwise.

    Attributes:
        feature: the name of its feature, which the extensions of a link set.
        verdict: a verdict on the topic, as `Extension.verdict` returns one, or None. After a change, call
            `route.judge_again()`.
        corrects_stamps: whether it leaves stamps on this machine's clock.
    """

    feature = ""
    verdict: Verdict | None = None
    corrects_stamps = False

    def change(self, content: bytes) -> bytes:
        """Return the content to publish for a message; both begin with the encapsulation header.

        Raises:
            TransformError: the message must not be published.
        """
        raise NotImplementedError


Transforms: TypeAlias = tuple[MessageTransform, ...]
"""In the order of their changes."""
FindTransform: TypeAlias = "Callable[[], Awaitable[MessageTransform | None]]"
FindTransforms: TypeAlias = "Callable[[], Awaitable[Transforms]]"
"""Called once the answer is awaited: a coroutine that is made before may never be."""


class FailedTransform(MessageTransform):
    """Stands for a feature's transform that has failed: no message is published."""

    def __init__(self, feature: str) -> None:
        self.feature = feature

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FailedTransform) and other.feature == self.feature

    __hash__ = None  # type: ignore[assignment]

    def change(self, content: bytes) -> bytes:
        raise TransformError(_FAILS.format(feature=self.feature))


def changed(content: bytes, transforms: Transforms) -> bytes:
    """Return a message as all of them change it.

    Raises:
        TransformError: one of them keeps it back, or has failed.
    """
    for each in transforms:
        try:
            content = each.change(content)
        except TransformError:
            raise
        except Exception as error:  # noqa: BLE001 -- of code that is not ours: a link must not end by it
            failed(each.feature, "transform", error)
            raise TransformError(_FAILS.format(feature=each.feature)) from None
    return content
