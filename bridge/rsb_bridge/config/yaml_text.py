"""YAML as session files have it: the core of YAML 1.2, with the line of everything."""

from __future__ import annotations

import contextlib
import re
import stat
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from rsb_bridge.config.decoding import join
from rsb_bridge.config.files import kind_of_file, stat_of
from rsb_bridge.config.keys import conceal, is_key_file
from rsb_bridge.model.session import Problem
from rsb_bridge.model.text import one_line
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

MAX_FILE = 1 << 20  # bytes; a thousand topics are a tenth of it
MAX_DEPTH = 20
"""Nodes in one another; a session has fewer than ten. PyYAML, and what reads its nodes, calls itself for each."""

# Of PyYAML's errors.
_COLON_TOO_MUCH = "mapping values are not allowed here"
_MAPPING = "tag:yaml.org,2002:map"
_SEQUENCE = "tag:yaml.org,2002:seq"
# Scalars as YAML 1.2 has them (core schema, section 10.3.2): in 1.1 a MAC of digits is a number and `no` is false.
# A whole number of 300 digits still fits a float; Python refuses to read one of more than 4,300.
_SCALARS: dict[str, tuple[re.Pattern[str], Callable[[str], Any]]] = {
    "tag:yaml.org,2002:null": (re.compile(r"~|null|Null|NULL|"), lambda text: None),
    "tag:yaml.org,2002:bool": (re.compile(r"true|True|TRUE|false|False|FALSE"), lambda text: text.lower() == "true"),
    "tag:yaml.org,2002:int": (re.compile(r"[-+]?[0-9]{1,300}"), int),
    "tag:yaml.org,2002:float": (re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"), float),
    "tag:yaml.org,2002:str": (re.compile(r".*", re.DOTALL), str),
}


class YamlMistake(Wording):
    """A text that is no YAML, or uses a feature of YAML that is not allowed."""

    CHARACTER = "character U+{code:04X} is not allowed"
    TAB = "begins with a tab: use spaces"
    NO_COLON = "no colon and space after the key: write {key}: and its value"
    NOT_CLOSED = "the {begin} here has no {end}, or a comma or colon is missing before line {line}"
    QUOTE_NOT_CLOSED = "the quote that begins here does not end"
    ALIAS = "aliases (*) are not allowed: write the value out"
    TOO_DEEP = "nested too deeply"
    TAG = "the tag {tag} is not allowed"
    DUPLICATE_KEY = "duplicate key, first on line {line}"
    EMPTY = "the file is empty"
    KEY_FILE = "this is a key file, not a session"


class FileProblem(Wording):
    NOT_A_FILE = "is {kind}, not a file"
    NO_SUCH_FILE = "no such file"
    NOT_READ = "cannot be read: {problem}"
    TOO_LARGE = "larger than {limit} bytes: not a session file"
    NOT_UTF8 = "is not UTF-8 text"


class SessionError(Exception):
    """A session is refused. Its text has a line for each problem: ``robot1.yaml:14: topics[2].protocol: ...``.

    Attributes:
        problems: what is wrong, in the file's order; at least one.
    """

    def __init__(self, path: Path, problems: Iterable[Problem]) -> None:
        self.path = path
        self.problems = tuple(sorted(problems, key=lambda problem: problem.line or 0))
        file = one_line(str(path))
        super().__init__("\n".join(f"{file}:{f'{each.line}:' if each.line else ''} {each}" for each in self.problems))


class YamlError(ValueError):
    """A text is no YAML, or uses a feature that is not allowed.

    Attributes:
        line: of the problem, from 1, or None if it has none.
    """

    def __init__(self, message: str, line: int | None) -> None:
        super().__init__(one_line(message))
        self.line = line


class Document(NamedTuple):
    """YAML as plain data that knows its lines."""

    data: Any  # mappings, lists and scalars
    lines: dict[str, int]  # the line of each location, from 1
    problems: list[Problem]  # features of YAML that a session file must not use
    root: yaml.Node  # the nodes, with their positions in the text

    def locate(self, problem: Problem) -> Problem:
        """Give a problem the line of its location, or of the closest mapping or list around it."""
        location = problem.location
        while location and location not in self.lines:
            location = location[: max(location.rfind("."), location.rfind("["), 0)]
        return replace(problem, line=self.lines.get(location))


def dump_yaml(data: Any, *, allow_unicode: bool = True, width: int = MAX_FILE) -> str:
    """Plain data as YAML: a block, with a line for each entry of a list in it.

    Args:
        data: mappings, lists and scalars.
        allow_unicode: if False, characters beyond ASCII are written as escape sequences.
        width: characters after which a line is broken where that may be.
    """
    return yaml.dump(
        data, Dumper=_Dumper, sort_keys=False, allow_unicode=allow_unicode, width=width, default_flow_style=None
    )  # fmt: skip


def inline(value: Any, quotes: str | None = None) -> str:
    """Plain data as YAML on one line, fit for any place in a document.

    Args:
        quotes: of a text, or None for quotes where they are needed.
    """
    style = quotes if quotes in ("'", '"') else None
    text = yaml.dump(
        [value], Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=MAX_FILE, default_flow_style=True,
        default_style=style,
    )  # fmt: skip
    return text.rstrip("\n")[1:-1]


def read_yaml(text: str, path: Path) -> Document:
    """Read YAML without its surprises: no YAML 1.1 scalars, no aliases, no tags, no duplicate keys.

    Raises:
        SessionError: it is not YAML at all.
    """
    # Before anything else, which might quote it.
    if is_key_file(text.removeprefix("\ufeff")):
        raise SessionError(path, [Problem("", YamlMistake.KEY_FILE())])
    try:
        node = compose(text)
    except YamlError as error:
        raise SessionError(path, [Problem("", str(error), error.line)]) from None
    if node is None:
        raise SessionError(path, [Problem("", YamlMistake.EMPTY())])
    document = Document(None, {"": node.start_mark.line + 1}, [], node)
    return document._replace(data=_plain(node, "", document))


def compose(text: str) -> yaml.Node | None:
    """Parse a YAML document without aliases, at most `MAX_DEPTH` deep. Return None if it is empty.

    Raises:
        YamlError: it is no YAML, has aliases, or is nested too deeply.
    """
    loader = None
    try:
        loader = _Loader(text)
        node: yaml.Node | None = loader.get_single_node()
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise YamlError(YamlMistake.CHARACTER(code=error.character), line) from None
    except yaml.MarkedYAMLError as error:
        raise _mistake(error, text) from None
    finally:
        if loader is not None:
            loader.dispose()
    return node


def _mistake(error: yaml.MarkedYAMLError, whole: str) -> YamlError:
    """Return the error with the line that has to be changed: PyYAML marks where it has noticed."""
    mark, began = error.problem_mark or error.context_mark, error.context_mark
    if mark is None:
        return YamlError(conceal(error.problem or ""), None)
    lines, at, context = whole.split("\n"), mark.line, error.context or ""
    text = lines[at] if at < len(lines) else ""  # nothing at the end of the text
    if "\t" in text[: len(text) - len(text.lstrip())]:
        return YamlError(YamlMistake.TAB(), at + 1)
    if error.problem == _COLON_TOO_MUCH:
        # A line without a colon goes on with the next one.
        before = next((line for line in range(at - 1, -1, -1) if lines[line].strip()), at)
        if (key := _key_without_colon(lines[before])) and before != at:
            return YamlError(YamlMistake.NO_COLON(key=key), before + 1)
    elif began is not None and context.endswith("simple key") and (key := _key_without_colon(lines[began.line])):
        return YamlError(YamlMistake.NO_COLON(key=key), began.line + 1)
    elif began is not None and began.line < at and context.endswith("quoted scalar"):
        return YamlError(YamlMistake.QUOTE_NOT_CLOSED(), began.line + 1)
    elif context.startswith("while parsing a flow") and (opened := _open_bracket(whole, mark.index)) is not None:
        begin = whole[opened.index]
        if opened.line < at:
            text = YamlMistake.NOT_CLOSED(begin=begin, end={"{": "}", "[": "]"}[begin], line=at + 1)
            return YamlError(text, opened.line + 1)
    return YamlError(conceal(", ".join(part for part in (context, error.problem) if part)), at + 1)


def _open_bracket(text: str, index: int) -> yaml.Mark | None:
    """Return where the innermost mapping or list in brackets begins that is open at a place of a text, or None."""
    opened: list[yaml.Mark] = []
    with contextlib.suppress(yaml.YAMLError):
        for token in yaml.scan(text, Loader=yaml.SafeLoader):
            if token.start_mark.index >= index:
                break
            if isinstance(token, yaml.FlowMappingStartToken | yaml.FlowSequenceStartToken):
                opened.append(token.start_mark)
            elif isinstance(token, yaml.FlowMappingEndToken | yaml.FlowSequenceEndToken):
                opened.pop()
    return opened[-1] if opened else None


def _key_without_colon(line: str) -> str:
    """Return the first word of a line that has no key, or an empty string."""
    content = line.partition("#")[0].strip().removeprefix("- ").strip()
    if not content or ": " in content or content.endswith(":") or content[0] in "[{'\"-":
        return ""
    return conceal(content.split()[0].partition(":")[0])


def _plain(node: yaml.Node, location: str, document: Document) -> Any:
    """Convert a node to plain data, and note its lines and problems in the document."""
    if node.tag not in (_MAPPING, _SEQUENCE, *_SCALARS):
        message = YamlMistake.TAG(tag=conceal(node.tag))
        document.problems.append(Problem(location, message, node.start_mark.line + 1))
    if isinstance(node, yaml.MappingNode):
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = conceal(key_node.value) if isinstance(key_node, yaml.ScalarNode) else "?"
            here, line = join(location, key), key_node.start_mark.line + 1
            if key in data:
                message = YamlMistake.DUPLICATE_KEY(line=document.lines[here])
                document.problems.append(Problem(here, message, line))
                continue
            document.lines[here] = line
            data[key] = _plain(value_node, here, document)
        return data
    if isinstance(node, yaml.SequenceNode):
        locations = [join(location, at) for at in range(len(node.value))]
        document.lines.update((at, each.start_mark.line + 1) for at, each in zip(locations, node.value, strict=True))
        return [_plain(each, at, document) for at, each in zip(locations, node.value, strict=True)]
    return scalar(node)


def scalar(node: yaml.Node) -> Any:
    """Convert a scalar's node by the rules of session files."""
    pattern, convert = _SCALARS.get(node.tag, _SCALARS["tag:yaml.org,2002:str"])
    # A value with a tag written before it (!!int x) may not fit the tag.
    return convert(node.value) if pattern.fullmatch(node.value) else node.value


class _Loader(yaml.SafeLoader):
    """Composes nodes only, with a bound on their depth."""

    yaml_implicit_resolvers: dict[str | None, Any] = {}  # noqa: RUF012 (PyYAML's own attribute, filled below)
    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise yaml.MarkedYAMLError(problem=YamlMistake.ALIAS(), problem_mark=event.start_mark)  # type: ignore[arg-type]
        if self._depth >= MAX_DEPTH:
            raise yaml.MarkedYAMLError(problem=YamlMistake.TOO_DEEP(), problem_mark=event.start_mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


class _Dumper(yaml.SafeDumper):
    """Quotes texts that YAML 1.1 or 1.2 would read as another type."""

    yaml_implicit_resolvers = {first: list(each) for first, each in yaml.SafeDumper.yaml_implicit_resolvers.items()}  # noqa: RUF012 (as above)

    def serialize(self, node: yaml.Node) -> None:
        if isinstance(node, yaml.MappingNode):
            node.flow_style = False  # the root, even where it holds nothing but scalars; what is in it as it is
        super().serialize(node)

    def ignore_aliases(self, data: Any) -> bool:
        return True  # a value that is there twice is written twice: session files have no aliases


for _tag, (_pattern, _) in list(_SCALARS.items())[:-1]:
    _anchored = re.compile(rf"(?:{_pattern.pattern})$")
    _Loader.add_implicit_resolver(_tag, _anchored, None)
    _Dumper.add_implicit_resolver(_tag, _anchored, None)
# Fields of messages may have these values, which no value of a session may.
_Dumper.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(r"(?:-?\.inf|\.nan)$"), None)


def read_text(path: Path) -> str:
    """Read a file's text, with the byte order mark if it has one.

    Raises:
        SessionError: it is missing, unreadable, too large, or not UTF-8.
    """
    text = text_if_there(path)
    if text is None:
        raise SessionError(path, [Problem("", FileProblem.NO_SUCH_FILE())])
    return text


def text_if_there(path: Path) -> str | None:
    """Do as `read_text`, but return None if nothing is there."""
    try:
        status = stat_of(path)
        if status is None:
            return None
        if not stat.S_ISREG(status.st_mode):  # before it is opened: a FIFO would wait for a writer
            raise SessionError(path, [Problem("", FileProblem.NOT_A_FILE(kind=kind_of_file(status.st_mode)))])
        with path.open("rb") as file:
            content = file.read(MAX_FILE + 1)
    except OSError as error:
        raise SessionError(path, [Problem("", FileProblem.NOT_READ(problem=error.strerror))]) from None
    if len(content) > MAX_FILE:
        raise SessionError(path, [Problem("", FileProblem.TOO_LARGE(limit=MAX_FILE))])
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise SessionError(path, [Problem("", FileProblem.NOT_UTF8(), line)]) from None
