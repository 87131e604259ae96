"""What a console asks an engine for: the next picture of topics, and the end of a view."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import Command, Right, Wording
from rsb_extras.pictures.picture import TOPICS_AT_ONCE, PictureError, Viewed, Wish, check_picture


class AnswerProblem(Wording):
    """The reason why a bridge's answer shows nothing."""

    INVALID = "the bridge sent no valid picture: {error}"


class LookAtTopics(Command[Viewed | None], frozen=True, tag="look"):
    """Wait for the next picture of topics, drawn by the side that publishes them.

    The result is None if there is no new one within some seconds: ask again. The view ends some seconds after the last
    question.

    Attributes:
        viewer: identifies the view; a random text.
        topics: their names on this side, or on the other side if they are not bridged. The first one gives the kind of
            picture; a map has the others over it.
        wish: the size and the way to draw; it may change with each question.
        link: the link to the side that publishes them, or an empty string if the engine is to find that out.
    """

    right = Right.LOOK
    refreshes = False
    cancellable = True
    viewer: Annotated[str, Meta(min_length=1, max_length=64)]
    topics: Annotated[tuple[str, ...], Meta(min_length=1, max_length=TOPICS_AT_ONCE)]
    wish: Wish
    link: str = ""

    def checked(self, result: Viewed | None) -> Viewed | None:
        if result is None:
            return None
        try:
            return msgspec.structs.replace(result, picture=check_picture(result.picture))
        except PictureError as error:
            raise PictureError(AnswerProblem.INVALID(error=error)) from None


class EndLook(Command[None], frozen=True, tag="end_look"):
    """End a view at once, which makes room for another one.

    Attributes:
        viewer: identifies the view, which may have ended.
    """

    right = Right.LOOK
    refreshes = False
    viewer: Annotated[str, Meta(min_length=1, max_length=64)]
