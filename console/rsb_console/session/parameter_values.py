"""Parameters of nodes: what a value that is typed means, what one that a node gives means, and what the node says."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import yaml

from rsb_bridge.config.fields_text import read_fields
from rsb_bridge.config.yaml_text import YamlError, compose, dump_yaml, inline
from rsb_bridge.model.calls import FieldError
from rsb_bridge.model.text import is_clean, one_line
from rsb_bridge.model.wording import Wording


class ParameterKind(NamedTuple):
    """A type of parameter.

    Attributes:
        name: name in `ros2 param describe` and ``--type``.
        words: words for a value, in a sentence.
    """

    number: int
    name: str
    words: str

    @property
    def field(self) -> str:
        """Field of rcl_interfaces/msg/ParameterValue with the value."""
        return f"{self.name}_value"


KINDS = tuple(
    ParameterKind(number, name, words)
    for number, (name, words) in enumerate(
        (
            ("bool", "bool"),
            ("integer", "integer"),
            ("double", "double"),
            ("string", "string"),
            ("byte_array", "array of bytes"),
            ("bool_array", "array of bools"),
            ("integer_array", "array of integers"),
            ("double_array", "array of doubles"),
            ("string_array", "array of strings"),
        ),
        1,
    )
)
"""All but the one of a parameter that has no value, whose number is 0."""
KIND_NAMES = tuple(kind.name for kind in KINDS)
_NAMED = {kind.name: kind for kind in KINDS}
_ELEMENTS: dict[type, str] = {bool: "bool", int: "integer", float: "double", str: "string"}

# As YAML 1.2 writes them (core schema, section 10.3.2).
_NULL = re.compile(r"null|Null|NULL|~|")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INTEGER = re.compile(r"[-+]?[0-9]+")
_BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_DOUBLE = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_SHOWN = 60  # characters of a value in words: a round figure
_DIGITS = 40  # no integer of 64 bits has more in any notation; beyond 4,300, `int` refuses with an error of its own
_BITS = 64


class ValueText(Wording):
    """Texts about a parameter's value."""

    NO_INTEGER = "{value} is no integer of {bits} bits; a double has a point, a text quotation marks"
    NO_REASON = "it gives no reason"
    NO_RESULT = "its answer does not say whether the parameter is set"


class ParameterRequest(NamedTuple):
    """A request to ``set_parameters``.

    Attributes:
        text: its fields, as YAML.
        meaning: the value and its type, in words.
        kind: one of `KIND_NAMES`.
        value: as plain data.
    """

    text: str
    meaning: str
    kind: str
    value: Any


def set_request(name: str, value: str, kind: str = "") -> ParameterRequest:
    """Return the request that sets one parameter.

    Args:
        value: as YAML: ``5`` is an integer, ``5.0`` a double, ``true`` a bool, ``[1, 2]`` an array, otherwise text.
        kind: one of `KIND_NAMES` that the value must have, or empty to take the kind that the value shows.

    Raises:
        FieldError: it is not a parameter value; if the value looks like a name, the message names the parameter.
    """
    try:
        meant, plain = _meant(_node(value), kind)
    except OverflowError as error:
        raise FieldError(f"{name}: {error}") from None
    request = {"parameters": [{"name": name, "value": {"type": meant.number, meant.field: plain}}]}
    shown = value.strip()
    meaning = f"{shown[:_SHOWN]}{'…' * (len(shown) > _SHOWN)} ({meant.words})"
    return ParameterRequest(dump_yaml(request), meaning, meant.name, plain)


def parameter_value(value: str, kind: str = "") -> tuple[str, Any]:
    """Return the type of a value, one of `KIND_NAMES`, and the value as plain data: bytes are integers.

    Args:
        value: as YAML, as for `set_request`.
        kind: one of `KIND_NAMES` that it must have, or empty to take the kind that it shows.

    Raises:
        FieldError: it is not a parameter value, or not of that kind.
    """
    # An empty word means an empty text; as YAML it would be no value.
    return value_of_node(_node(value or "''"), kind)


def value_of_node(node: yaml.Node, kind: str = "") -> tuple[str, Any]:
    """Do as `parameter_value` for a value in a YAML document."""
    try:
        meant, plain = _meant(node, kind)
    except OverflowError as error:
        raise FieldError(str(error)) from None
    return meant.name, plain


def shown_value(plain: Any, most: int = _SHOWN) -> str:
    """Return a value as YAML on one line, cut if it has more than `most` characters."""
    text = inline(plain)
    if not is_clean(text):  # a text with ends of lines, or signs that nobody sees
        text = one_line(inline(plain, '"'))
    return f"{text[:most]}{'…' * (len(text) > most)}"


def _node(value: str) -> yaml.Node:
    try:
        node = compose(value)
    except YamlError as error:
        raise FieldError(f"{error}; put a text with such signs between quotation marks") from None
    if node is None:
        raise FieldError("missing: 5, 5.0, true, a text, or [1, 2]; an empty text is ''")
    return node


def _meant(node: yaml.Node, kind: str) -> tuple[ParameterKind, Any]:
    if kind == "string" and isinstance(node, yaml.ScalarNode):
        return _NAMED[kind], str(node.value)  # `5`, too, and `true`
    plain = _plain(node)
    shown = _NAMED[kind] if kind else _kind(plain)
    elements = plain if isinstance(plain, list) else [plain]
    if shown.name.removesuffix("_array") == "double" and {type(each) for each in elements} <= {int, float}:
        elements[:] = map(float, elements)
        plain = elements if isinstance(plain, list) else elements[0]
    if isinstance(plain, list) is not shown.name.endswith("_array") or not _fits(elements, shown):
        raise FieldError(f"this is no {shown.words}")
    return shown, plain


def _fits(elements: list[Any], kind: ParameterKind) -> bool:
    # For `isinstance`, a bool is an int.
    if kind.name == "byte_array":
        return all(type(each) is int and 0 <= each <= 255 for each in elements)
    return all(_ELEMENTS.get(type(each)) == kind.name.removesuffix("_array") for each in elements)


def _plain(node: yaml.Node) -> Any:
    if isinstance(node, yaml.SequenceNode):
        return [_plain(each) for each in node.value]
    if not isinstance(node, yaml.ScalarNode):
        raise FieldError("a parameter has no fields: write a value, or an array of values")
    text = str(node.value)
    if node.style is not None:  # between quotation marks, or a block
        return text
    if _NULL.fullmatch(text):
        raise FieldError("a parameter cannot be null; put the text null between quotation marks")
    if _BOOL.fullmatch(text):
        return text.lower() == "true"
    if _INTEGER.fullmatch(text) or _BASED.fullmatch(text):
        return _integer(text)
    # `float` knows inf and nan without the point only.
    return float(text.replace(".", "", 1) if text[-1] in "fFnN" else text) if _DOUBLE.fullmatch(text) else text


def _integer(text: str) -> int:
    """Parse an integer of 64 bits.

    Raises:
        OverflowError: it is none, and would be another number as a double.
    """
    number = int(text, 0 if _BASED.fullmatch(text) else 10) if len(text) <= _DIGITS else None
    if number is None or not -(1 << _BITS - 1) <= number < 1 << _BITS - 1:
        cut = f"{text[:_DIGITS]}{'…' * (len(text) > _DIGITS)}"
        raise OverflowError(ValueText.NO_INTEGER(value=cut, bits=_BITS))
    return number


def _kind(plain: Any) -> ParameterKind:
    if not isinstance(plain, list):
        return _NAMED[_ELEMENTS[type(plain)]]
    kinds = {type(each) for each in plain}
    if not plain:
        raise FieldError("an empty array has no type: give --type, or in the form call set_parameters")
    if list in kinds:
        raise FieldError("an array holds bools, numbers or texts, no arrays")
    if kinds == {int, float}:
        return _NAMED["double_array"]
    if len(kinds) > 1:
        raise FieldError("the elements of an array have one type: put texts between quotation marks")
    return _NAMED[f"{_ELEMENTS[kinds.pop()]}_array"]


def refusal(answer: str) -> str | None:
    """Return the node's reason for not setting a parameter, or None if it was set.

    Args:
        answer: the response of ``set_parameters``, as YAML.
    """
    try:
        fields = read_fields(answer)
    except FieldError:
        fields = {}
    results = fields.get("results") if isinstance(fields, dict) else None
    # An operator must not take for set what the node has not said to be.
    if not isinstance(results, list) or not results:
        return ValueText.NO_RESULT()
    for each in results:
        if not isinstance(each, dict) or each.get("successful") != "true":
            return str((each.get("reason") if isinstance(each, dict) else "") or ValueText.NO_REASON())
    return None
