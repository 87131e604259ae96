"""Parameters of nodes with their descriptors, and what one side of a link asks the other about them, with bounds."""

from __future__ import annotations

import sys
from hashlib import blake2b
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import PRINTABLE, ControlMessageBase, Count, Name, Reason, Wording, one_line
from rsb_extras.node_control.change_records import Target
from rsb_extras.node_control.parameter_types import ParameterType

MOST_PARAMETERS = 2000
"""Of a node. A round figure: Nav2's controller server has 300."""
MOST_IN_PAGE, MOST_NAMED = 200, 100
"""Parameters in one answer, and names in one question. Round figures."""
MOST_NODES = 500
"""Nodes in a list."""
LARGEST_VALUE = 256 << 10
"""Bytes of a value that crosses, packed: a robot's description (URDF) has some tens of thousands."""
SHOWN_VALUE = 256
"""Bytes of a value, packed, that a list has; larger ones are asked for by name."""
MOST_SET, LARGEST_CHANGE = 200, 32 << 10
"""Parameters in one change, and bytes of their values: a console's request has 64 KiB."""

Integer: TypeAlias = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
Figure: TypeAlias = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
ParameterName: TypeAlias = Annotated[str, Meta(min_length=1, max_length=255, pattern=PRINTABLE)]
_PLAIN: dict[ParameterType, Any] = {
    "not_set": None, "bool": bool, "integer": Integer, "double": float, "string": str, "byte_array": bytes,
    "bool_array": list[bool], "integer_array": list[Integer], "double_array": list[float], "string_array": list[str],
}  # fmt: skip
_DECODERS = {name: msgspec.msgpack.Decoder(plain) for name, plain in _PLAIN.items()}
_SHOWN = 60  # characters of a value in a line. A round figure


class ParameterValue(msgspec.Struct, frozen=True, omit_defaults=True):
    """A value, packed: a text in it may have any characters, and an array many elements.

    Attributes:
        content: the value in MessagePack, or empty if it is not set or left out.
    """

    type: ParameterType = "not_set"
    content: Annotated[bytes, Meta(max_length=LARGEST_VALUE)] = b""

    @classmethod
    def of(cls, kind: ParameterType, plain: Any) -> ParameterValue:
        """Pack a value; bytes are those of a byte array."""
        return cls(kind, msgspec.msgpack.encode(plain))

    @property
    def digest(self) -> str:
        """A sign of the value, which differs from those of others."""
        return blake2b(f"{self.type} ".encode() + self.content if self.content else b"", digest_size=8).hexdigest()

    def plain(self) -> Any:
        """Return the value as plain data, or None if there is none: a byte array is a list of integers.

        Raises:
            ValueError: it is none of its type.
        """
        value = _DECODERS[self.type].decode(self.content) if self.content else None
        return list(value) if isinstance(value, bytes) else value

    def __str__(self) -> str:
        """Return the value in a log's line."""
        try:
            plain = self.plain()
        except ValueError:
            return "?"
        text = str(plain).lower() if isinstance(plain, bool) else one_line(str(plain))
        return f"{text[:_SHOWN]}{'…' * (len(text) > _SHOWN)}"


class ParameterRange(msgspec.Struct, frozen=True, array_like=True):
    """The bounds of a number, and the step from the lower one, or 0 for any."""

    low: Integer | Figure
    high: Integer | Figure
    step: Annotated[int, Meta(ge=0, le=2**63 - 1)] | Annotated[float, Meta(ge=0, le=1e300)]


class NodeParameter(msgspec.Struct, frozen=True, omit_defaults=True):
    """A parameter with its descriptor.

    Attributes:
        size: bytes of a value that is left out here, packed, or 0.
        dynamic: whether its type may change.
        constraints: what its node says that its range does not.
        ranges: none or one.
    """

    name: ParameterName
    value: ParameterValue = ParameterValue()
    size: Count = 0
    read_only: bool = False
    dynamic: bool = False
    description: Reason = ""
    constraints: Reason = ""
    ranges: Annotated[tuple[ParameterRange, ...], Meta(max_length=1)] = ()


class NewValue(msgspec.Struct, frozen=True, omit_defaults=True):
    """A parameter's value to be set.

    Attributes:
        seen: the digest of the value that was seen before, or empty: then it is set whatever there is.
    """

    name: ParameterName
    value: ParameterValue
    seen: Annotated[str, Meta(max_length=16, pattern=PRINTABLE)] = ""


NewValues: TypeAlias = Annotated[tuple[NewValue, ...], Meta(max_length=MOST_SET)]


class ParameterNode(msgspec.Struct, frozen=True, omit_defaults=True):
    """A node with parameters.

    Attributes:
        allowed: whether the one who asks may change them.
    """

    name: Target
    allowed: bool = False


class AskParameters(ControlMessageBase, frozen=True, omit_defaults=True):
    """Asks for a node's parameters, or for the nodes that have some. Answered by a `ParametersAnswer`.

    Attributes:
        node: of which, or empty for the nodes.
        names: those that are asked for, or empty for all.
        after: the last name of the page before, or empty.
        whole: whether large values are asked for, too.
    """

    request: Count
    node: Target | Literal[""] = ""
    names: Annotated[tuple[ParameterName, ...], Meta(max_length=MOST_NAMED)] = ()
    after: Name = ""
    whole: bool = False


class ParametersAnswer(ControlMessageBase, frozen=True, omit_defaults=True):
    """A page of a node's parameters, sorted by name, or the nodes that have parameters.

    Attributes:
        more: whether a page follows.
        problem: why there is no answer, or empty.
    """

    request: Count
    parameters: Annotated[tuple[NodeParameter, ...], Meta(max_length=MOST_IN_PAGE)] = ()
    more: bool = False
    nodes: Annotated[tuple[ParameterNode, ...], Meta(max_length=MOST_NODES)] = ()
    problem: Reason = ""


class ParametersProblem(Wording):
    """The reason why a node's parameters are not read or set."""

    NO_ANSWER = "{node}: its answer about its parameters cannot be read: {error}"
    NO_REASON = "it gives no reason"
    REFUSED = "{node} does not set {names}: {reason}"
    NOT_SET = "not set"
    OTHER_BY_NOW = "{name} of {node} is {value} by now, and not what was seen before: read it again"
