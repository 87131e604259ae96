"""What follows the other side's graph by patterns of names (PROTOCOL.md, 3 and 10)."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.model.patterns import NAMES_FOLLOWED, PATTERNS_PER_LINK

# msgspec resolves the annotations at run time
from rsb_bridge.wire.fields import Count, Name
from rsb_bridge.wire.message import ControlMessageBase


class NamePattern(msgspec.Struct, frozen=True, omit_defaults=True):
    """Names that are asked for.

    Attributes:
        pattern: of names on the side that is asked (`rsb_bridge.model.patterns`); what is none asks for nothing.
        kind: of what they are names; what only newer versions have is ignored.
    """

    pattern: Name
    kind: Name = "topic"


class FoundName(msgspec.Struct, frozen=True, omit_defaults=True):
    """A name that matches.

    Attributes:
        name: it.
        type: empty where its endpoints disagree, or it has none.
        kind: what it is; another one is a newer peer's.
    """

    name: Name
    type: Name = ""
    kind: Name = "topic"


Patterns: TypeAlias = Annotated[tuple[NamePattern, ...], Meta(max_length=PATTERNS_PER_LINK)]
Names: TypeAlias = Annotated[tuple[FoundName, ...], Meta(max_length=NAMES_FOLLOWED)]


class Follow(ControlMessageBase, frozen=True):
    """Either side asks to be told which names of the peer's graph match, from now on. Takes an earlier one's place.

    Attributes:
        request: counts up.
        patterns: none ends it.
    """

    request: Count
    patterns: Patterns = ()


class Followed(ControlMessageBase, frozen=True):
    """What has changed since the last answer to a `Follow`; the first one has all there is, even if that is nothing.

    Attributes:
        request: the `Follow`'s.
        present: what matches, and did not or had another type.
        gone: what does not any more.
        more: how many more match than are told.
    """

    request: Count
    present: Names = ()
    gone: Names = ()
    more: Count = 0
