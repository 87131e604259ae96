"""Make a session of plain data: which keys there are, and what kind of value each takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from difflib import get_close_matches
from functools import cache
from types import UnionType
from typing import Any, Final, Literal, TypeVar, Union, get_args, get_origin

import msgspec
from msgspec.structs import FieldInfo, fields

from rsb_bridge.config.keys import KEY_LENGTH, conceal, is_key
from rsb_bridge.feature import BRINGS_TRANSPORTS
from rsb_bridge.model.session import Problem
from rsb_bridge.model.topic_keys import TOPIC_KEYS
from rsb_bridge.model.wording import Wording

T = TypeVar("T", bound=msgspec.Struct)

_NOUNS = {str: "text", int: "a whole number", float: "a number", bool: "true or false", tuple: "a list"}


class ValueMistake(Wording):
    """A value of the wrong kind, a key that is missing, or one that does not exist."""

    NO_VALUE = "has no value: give one, or leave the key out"
    FILE_NOT_A_MAPPING = "is not a mapping of {keys}, ..."
    NOT_A_MAPPING = "{value} is not a mapping of {keys}, ...{hint}"
    NO_KNOWN_KEY = "has no key of a {model}: {keys}"
    MISSING = "missing: give {expected}"
    UNKNOWN_KEY = "unknown key: the keys here are {keys}"
    MISSPELT_KEY = "unknown key{hint}"
    SECRET_KEY = "unknown key: a session file never holds the key itself; give the key file's name as key_file"  # noqa: S105 (a text)
    IS_A_KEY = "is a key itself: put it in a file with mode 0600, and give that file's name as key_file"
    NOT_A_LIST = "{value} is not a list{hint}"
    MISFIT = "{value} is not {expected}{hint}"
    OF_FEATURE = "{value} needs the feature {feature}, which is not installed: pip install 'rsb-console[{feature}]'"


class Hint(Wording):
    """The remedy behind a mistake, in brackets."""

    ENTRY = ": write each entry as - {entry}"
    DID_YOU_MEAN = " (did you mean {name}?)"
    QUOTES = " (put it in quotes)"
    NO_QUOTES = " (leave out the quotes)"


# Replacements for required values that are missing or of the wrong kind, so that all rules can run.
_STAND_INS = {
    "name": "unnamed",
    "role": "client",
    "server_ip": "localhost",
    "server_port": 1,
    "topic": "/unnamed",
    "direction": "transmit",
    "service": "/unnamed",
    "action": "/unnamed",
    "node": "/unnamed",
    "provider": "server",
    "key_file": "unnamed.key",
    "seconds": 60.0,
}
_MEANINGS: Final = {"provider": " (the side whose node answers)"}


def read(data: object, model: type[T], problems: list[Problem], location: str = "") -> T:
    """Make a struct of plain data, and report every value that does not fit.

    Args:
        data: mappings, lists and scalars, as YAML has them.
        model: `rsb_bridge.config.file_form.SESSION_FILE`, or any struct. It may have `hints`: what to say of keys that
            are not its own.
        problems: the problems found are added here.
        location: of `data`, for the problems.

    Returns:
        The struct. In it, a value with a problem is the default; a required one is something harmless.
    """
    known = {field.encode_name: field for field in _fields(model)}
    values: dict[str, Any] = {name: _STAND_INS[name] for name, field in known.items() if field.required}
    if not isinstance(data, Mapping):
        keys = ", ".join(values or known)
        message = (
            ValueMistake.NOT_A_MAPPING(value=show(data), keys=keys, hint=_entry_like(model, data))
            if location
            else ValueMistake.FILE_NOT_A_MAPPING(keys=keys)  # it may hold anything, so it is not quoted
        )
        problems.append(Problem(location, message))
        return model(**values)
    # A file of something else: one mistake instead of one for each of its keys.
    if data and not location and known.keys().isdisjoint(data):
        message = ValueMistake.NO_KNOWN_KEY(model=model.__name__.lower(), keys=", ".join(known))
        problems.append(Problem(location, message))
        return model(**values)
    hints: Mapping[str, str] = getattr(model, "hints", {})
    problems.extend(
        Problem(join(location, str(key)), hints.get(str(key)) or _unknown_key(str(key), list(known)))
        for key in data
        if key not in known
    )
    for name, field in known.items():
        if name in data:
            value = _value(_zero_of(field.name, data[name]), field.type, problems, join(location, name))
            if value is not msgspec.UNSET:
                values[field.name] = value
        elif field.required:
            expected = f"{_expected(field.type)}{_MEANINGS.get(name, '')}"
            problems.append(Problem(join(location, name), ValueMistake.MISSING(expected=expected)))
    return model(**values)


def _zero_of(name: str, value: object) -> object:
    """Return a value, or 0 for the word that a key has for it: ``max_age: none``."""
    key = TOPIC_KEYS.get(name)
    return 0.0 if key is not None and key.zero_word and value == key.zero_word else value


@cache
def _fields(model: type[msgspec.Struct]) -> tuple[FieldInfo, ...]:
    """Return `msgspec.structs.fields`, cached: each call evaluates the model's annotations, which takes 0.2 ms."""
    return fields(model)


def join(location: str, key: str | int) -> str:
    """Return the location of a mapping's value or of a list's entry."""
    if isinstance(key, int):
        return f"{location}[{key}]"
    return f"{location}.{key}" if location else key


def under(location: str, problems: Iterable[Problem]) -> Iterator[Problem]:
    """Yield the problems of a part of a session, with its location before the keys that they name."""
    for each in problems:
        yield replace(each, location=join(location, each.location) if each.location else location)


def show(value: object) -> str:
    """Quote a value in a message: on one line, shortened, and without any encryption key in it."""
    text = conceal(repr(value))
    return text if len(text) <= 60 else f"{text[:57]}..."


def did_you_mean(word: str, options: list[str]) -> str:
    """Return a hint at the option closest to a mistyped word, or an empty string if none is close."""
    match = get_close_matches(word.lower(), options, n=1)
    return Hint.DID_YOU_MEAN(name=match[0]) if match else ""


def _value(value: object, kind: Any, problems: list[Problem], location: str) -> Any:
    """Return what the struct gets, or UNSET if the value has a problem."""
    lists = [each for each in _alternatives(kind) if get_origin(each) is tuple]
    if not lists or (not isinstance(value, list | tuple) and lists != _alternatives(kind)):
        return _entry(value, kind, problems, location)
    if not isinstance(value, list | tuple):
        message = ValueMistake.NO_VALUE()
        if value is not None:
            hint = _entry_like(get_args(lists[0])[0], value)
            message = ValueMistake.NOT_A_LIST(value=show(value), hint=hint)
        problems.append(Problem(location, message))
        return msgspec.UNSET
    # Each entry by itself: a mistake has its place.
    entries = [_entry(each, get_args(lists[0])[0], problems, join(location, at)) for at, each in enumerate(value)]
    return tuple(entry for entry in entries if entry is not msgspec.UNSET)


def _entry_like(kind: Any, value: object) -> str:
    """Return an example of a list's entry: of its required keys the first has the name that stands there, if any."""
    if not (isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
        return ""
    name = next(iter(value), None) if isinstance(value, Mapping) else value
    required = [field.encode_name for field in _fields(kind) if field.required]
    # One that is a key of such an entry itself is no name.
    if not required or not isinstance(name, str) or name in kind.__struct_fields__ or holds_key(name):
        name = "..."
    values = [name, *["..."] * len(required)]
    return Hint.ENTRY(entry="{" + ", ".join(map("{}: {}".format, required, values)) + "}")


def _entry(value: object, kind: Any, problems: list[Problem], location: str) -> Any:
    model = get_args(kind)[1] if get_origin(kind) is dict else None
    if get_origin(model) is tuple or (isinstance(model, type) and issubclass(model, msgspec.Struct)):
        return _named(value, model, problems, location)
    structs = [each for each in _alternatives(kind) if isinstance(each, type) and issubclass(each, msgspec.Struct)]
    # Where a text may stand instead of a mapping, only a mapping is read as one.
    if structs and (structs[0] is kind or isinstance(value, Mapping)):
        return read(value, structs[0], problems, location)
    if holds_key(value):
        # The key is not quoted: messages end up in logs.
        problems.append(Problem(location, ValueMistake.IS_A_KEY()))
        return msgspec.UNSET
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError:
        problems.append(Problem(location, _misfit(value, kind)))
        return msgspec.UNSET


def _named(value: object, model: Any, problems: list[Problem], location: str) -> Any:
    """Return structs or lists by the names that the operator has given them, each mistake with its place."""
    if not isinstance(value, Mapping):
        problems.append(Problem(location, _misfit(value, dict)))
        return msgspec.UNSET
    problems += [Problem(location, _misfit(name, str)) for name in value if not isinstance(name, str)]
    named = {
        name: _value(each, model, problems, join(location, name))
        for name, each in value.items()
        if isinstance(name, str)
    }
    return {name: each for name, each in named.items() if each is not msgspec.UNSET}


def holds_key(value: object) -> bool:
    """Whether a value is an encryption key, possibly written as a name."""
    return isinstance(value, str) and len(value) >= KEY_LENGTH and is_key(value.rpartition("/")[2])


def _misfit(value: object, kind: Any) -> str:
    if value is None:
        return ValueMistake.NO_VALUE()
    hint = ""
    if options := _options(kind):
        if isinstance(value, str) and value in BRINGS_TRANSPORTS and "tcp" in options:
            return ValueMistake.OF_FEATURE(value=value, feature=BRINGS_TRANSPORTS[value])
        hint = did_you_mean(value, options) if isinstance(value, str) else ""
    elif str in _alternatives(kind) and isinstance(value, int | float):
        hint = Hint.QUOTES()
    elif isinstance(value, str) and value.strip().isdecimal():
        hint = Hint.NO_QUOTES()
    return ValueMistake.MISFIT(value=show(value), expected=_expected(kind), hint=hint)


def _expected(kind: Any) -> str:
    options = _options(kind)
    if options:
        expected = f"one of {', '.join(options)}" if len(options) > 1 else options[0]
        lists = [get_args(each)[0] for each in _alternatives(kind) if get_origin(each) is tuple]
        return f"{expected}, or a list of {'whole numbers' if int in lists else 'these'}" if lists else expected
    nouns = [_NOUNS.get(get_origin(each) or each, "a mapping") for each in _alternatives(kind)]
    return " or ".join(nouns)


def _alternatives(kind: Any) -> list[Any]:
    members = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return [member for member in members if member is not type(None)]


def _options(kind: Any) -> list[str]:
    return [option for each in _alternatives(kind) if get_origin(each) is Literal for option in get_args(each)]


def _unknown_key(key: str, known: list[str]) -> str:
    if "key_file" in known and key in ("key", "encryption_key"):
        return ValueMistake.SECRET_KEY()
    if hint := did_you_mean(key, known):
        return ValueMistake.MISSPELT_KEY(hint=hint)
    return ValueMistake.UNKNOWN_KEY(keys=", ".join(known))
