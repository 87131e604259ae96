"""The question what of a recording of the other side is completed, and by which recording of this side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import Field, FormScreen, Spec
from rsb_console.notation.formats import byte_count
from rsb_extras.courier.courier_command import texts_of
from rsb_extras.courier.courier_records import MARGIN, MOST_TOPICS
from rsb_extras.courier.picking import HEADED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rsb_extras.courier.courier_records import ListedRecording

_MOST_OFFERED = 16
"""Recordings of this side to choose from. A round figure: `record get --with` takes any."""


class CompletingText(Wording):
    TITLE = "Complete {name} of {side}"
    WITH = "One file gets what came live on this side, and what is missing. At most {size} cross, less what came live."
    ALL = "all that this bridge has recorded then"
    ONE = "{name}, {span}, {size}"
    TOPICS = "Names of either side, with a space between them."
    TOO_MANY = "at most {most} topics"


class CompletingForm(FormScreen[tuple[tuple[str, ...], str]]):
    """The topics, none for all, and the id of the recording of this side, or an empty text for all that there is.

    Args:
        recording: of the other side.
        here: this side's recordings, the best choices first.
    """

    def __init__(self, side: str, recording: ListedRecording, here: Sequence[ListedRecording]) -> None:
        size = byte_count(recording.size + HEADED * recording.messages)
        known = ("", CompletingText.ALL()), *((each.id, _option(each)) for each in _overlapping(recording, here))
        super().__init__(
            CompletingText.TITLE(name=recording.name, side=side),
            [
                Field(Spec("with", "With", CompletingText.WITH(size=size), options=known)),
                Field(Spec("topics", "Topics", CompletingText.TOPICS(), blank="all")),
            ],
            "Complete",
        )

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        too_many = len(values["topics"].split()) > MOST_TOPICS
        return {"topics": CompletingText.TOO_MANY(most=MOST_TOPICS)} if too_many else {}

    def result(self, values: Mapping[str, str]) -> tuple[tuple[str, ...], str]:
        return tuple(values["topics"].split()), values["with"]


def _overlapping(recording: ListedRecording, here: Sequence[ListedRecording]) -> list[ListedRecording]:
    begin, end = recording.begin - MARGIN, (recording.end or recording.begin) + MARGIN
    return [each for each in here if each.begin <= end and begin <= max(each.begin, each.end)][:_MOST_OFFERED]


def _option(listed: ListedRecording) -> str:
    _, span, size, _, _ = texts_of(listed)
    return CompletingText.ONE(name=listed.name, span=span, size=size)
