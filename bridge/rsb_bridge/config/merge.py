"""Put the changes of a session into the text of its file, so that the rest stays as the operator wrote it.

A YAML emitter writes a whole document in one layout. Here the parsed nodes only say where each value is in the text.
What changed is replaced, removed or inserted there, and every other character stays. A value that goes takes the rest
of its line with it. A comment on a line of its own stays, unless it is inside an entry that goes.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeAlias

import msgspec
import yaml
from msgspec.structs import fields

from rsb_bridge.config.file_form import as_plain, as_written
from rsb_bridge.config.yaml_text import inline
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import ArmedName, Grant

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence, Set

    from rsb_bridge.model.session import Session

Pair: TypeAlias = tuple[yaml.Node, yaml.Node]
Entry: TypeAlias = msgspec.Struct
"""An entry of ``topics``, ``services``, ``actions``, ``parameters`` or ``clients``, as the file has it."""

_BREAK = re.compile(r"\r\n|[\n\r\x85\u2028\u2029]")  # YAML 1.1, section 5.4
_BLANKS = re.compile(r"[ \t]*")
_BEFORE_COMMENT = re.compile(r"[ \t]+(?=#)")
_REST_OF_LINE = re.compile(r"[ \t]*(#.*)?$")
_GONE = object()
_QOS_KEYS = ("profile", *(field.name for field in fields(Qos)))


class LayoutError(ValueError):
    """A text is written in a way that cannot be edited here: with the key of a value behind a question mark."""


def merge(text: str, root: yaml.Node, old: Session, new: Session) -> str:
    """Return the text of a session's file with the session's changes in it.

    Topics, services and clients keep the file's order; new ones come last.

    Args:
        root: of the text, as PyYAML composes it.
        old: what the text says.
        new: what it is to say.

    Raises:
        LayoutError: the text is written in a way that cannot be edited here.
    """
    merger = _Merger(text)
    merger.struct(root, as_written(old), as_written(new))
    return merger.text()


def identity(entry: Entry) -> tuple[str, ...]:
    """Return the parts that identify an entry in its list: its name, and the direction or provider if it crosses."""
    name, second = entry.__struct_fields__[:2]
    return tuple(getattr(entry, key) for key in (name, second) if key in (name, "direction", "provider"))


class _Merger:
    """A text and its edits, which all refer to the text as it was."""

    def __init__(self, text: str) -> None:
        breaks = list(_BREAK.finditer(text))
        self._text = text
        self._newline = breaks[0].group() if breaks else "\n"
        self._starts = [0, *(each.end() for each in breaks)]
        self._ends = [*(each.start() for each in breaks), len(text)]
        self._edits: list[tuple[int, int, str]] = []

    def text(self) -> str:
        parts, at = [], 0
        # By place alone: of several at one place, the one that was made first comes first.
        for start, end, new in sorted(self._edits, key=lambda edit: edit[:2]):
            if start < at:  # new lines behind one that goes, which takes its line break with it
                parts.append(new.removeprefix(self._newline) + self._newline)
            else:
                parts += [self._text[at:start], new]
            at = max(at, end)
        return "".join([*parts, self._text[at:]])

    # --- what changes

    def struct(self, node: yaml.Node, old: msgspec.Struct, new: msgspec.Struct) -> None:
        """Edit a session or a list's entry."""
        assert isinstance(node, yaml.MappingNode)
        pairs = {key.value: (key, value) for key, value in node.value}
        for key, _ in node.value:
            at = key.start_mark.index
            if self._text[self._line_start(at) : at].rstrip().endswith("?"):
                raise LayoutError
        plain = as_plain(new)
        changes: dict[str, Any] = {}
        for name in new.__struct_fields__:
            before, after = getattr(old, name), getattr(new, name)
            if before == after:
                continue
            if name in pairs and self._nested(*pairs[name], before, after):
                continue
            # A value that became the default goes if the file has it.
            if name in plain or name in pairs:
                changes[name] = plain.get(name, _GONE)
        self._mapping(node, changes, new.__struct_fields__)

    def _nested(self, key: yaml.Node, node: yaml.Node, before: Any, after: Any) -> bool:
        """Edit inside a value. Return False if the whole value must be replaced or removed instead."""
        if isinstance(node, yaml.SequenceNode) and isinstance(before, tuple):
            # Rights and armed names have no identity by which an entry could be found again, and may be texts.
            if any(
                isinstance(each, msgspec.Struct) and not isinstance(each, Grant | ArmedName)
                for each in (*before, *after)
            ):
                matched = _matched(before, after)
                for at, to in matched.items():
                    self.struct(node.value[at], before[at], after[to])
                added = [as_plain(each) for to, each in enumerate(after) if to not in matched.values()]
                self._sequence(key, node, set(range(len(before))) - matched.keys(), added)
                return True
            # Words keep their layout as long as some go and others come last; any other change writes all of them.
            kept = [each for each in before if each in after]
            if tuple(kept) == after[: len(kept)] and len(node.value) == len(before):
                gone = {at for at, each in enumerate(before) if each not in after}
                self._sequence(key, node, gone, as_plain(after[len(kept) :]))
                return True
        if isinstance(node, yaml.MappingNode) and isinstance(after, dict):
            changes = {key: value for key, value in after.items() if before.get(key, _GONE) != value}
            changes |= {key: _GONE for key in before if key not in after}
            # Else no key stays, to whose place the others could be added.
            if any(key in after for key in before):
                self._mapping(node, changes, _QOS_KEYS)
                return True
        return False

    # --- mappings

    def _mapping(self, node: yaml.MappingNode, changes: Mapping[str, Any], order: Sequence[str]) -> None:
        """Edit a mapping that keeps at least one key.

        Args:
            changes: the new values by key; `_GONE` where the key goes.
            order: of the keys, for new ones.
        """
        pairs: list[Pair] = node.value
        at = {key.value: index for index, (key, _) in enumerate(pairs)}
        gone = {at[key] for key, value in changes.items() if value is _GONE and key in at}
        for key, value in changes.items():
            if value is not _GONE and key in at:
                self._set(pairs[at[key]], value, flow=bool(node.flow_style))
        if node.flow_style:
            self._remove_flow(pairs, gone)
        else:
            self._remove_block_pairs(pairs, gone)
        stays = [index for index in range(len(pairs)) if index not in gone]
        ranks = [order.index(key.value) for key, _ in pairs]
        for key in sorted((each for each in changes if each not in at), key=order.index):
            before = [index for index in stays if ranks[index] < order.index(key)]
            neighbour = max(before, key=ranks.__getitem__, default=stays[-1])
            self._add_pair(node, pairs[neighbour], key, changes[key])

    def _add_pair(self, node: yaml.MappingNode, neighbour: Pair, key: str, value: Any) -> None:
        end = self._end(neighbour[1])
        if node.flow_style:
            self._edit(end, end, f", {key}: {inline(value)}")
            return
        indent = " " * node.start_mark.column
        end = self._line_end(end)
        entries = isinstance(value, list | tuple) and isinstance(value[0], dict)
        lines = [f"{indent}  - {inline(each)}" for each in value] if entries else []
        first = f"{indent}{key}:" if entries else f"{indent}{key}: {inline(value)}"
        self._edit(end, end, "".join(self._newline + line for line in (first, *lines)))

    def _set(self, pair: Pair, value: Any, *, flow: bool) -> None:
        key, node = pair
        start, end = node.start_mark.index, self._end(node)
        new = inline(value, node.style if isinstance(node, yaml.ScalarNode) and isinstance(value, str) else None)
        if start == end:  # nothing is written there
            new = f" {new}" if ":" in self._text[key.end_mark.index : start] else f": {new}"
        elif isinstance(node, yaml.CollectionNode) and not (flow or node.flow_style):  # on lines of its own
            colon = self._text.index(":", key.end_mark.index) + 1
            if not self._text[colon:start].strip():
                start, new = colon, f" {new}"
        comment = None if flow else _BEFORE_COMMENT.match(self._text, end)
        if comment is not None:  # it stays in its column, as far as there is room
            new += " " * max(1, comment.end() - start - len(new))
            end = comment.end()
        self._edit(start, end, new)

    def _remove_block_pairs(self, pairs: Sequence[Pair], gone: set[int]) -> None:
        """Remove the lines of pairs. The first pair may share its line with the dash of a list's entry."""
        first = pairs[0][0].start_mark.index
        dash = self._text[self._line_start(first) : first].rstrip()
        if 0 in gone and dash:
            stays = next(index for index in range(len(pairs)) if index not in gone)
            next_key = pairs[stays][0].start_mark.index
            gaps = (self._text[self._line_end(self._end(one[1])) : other[0].start_mark.index]
                    for one, other in pairwise(pairs[: stays + 1]))  # fmt: skip
            if any(gap.strip() for gap in gaps):  # comments between, which stay: so the dash stands alone
                self._edit(self._line_start(first) + len(dash), self._line_end(self._end(pairs[0][1])), "")
                gone = gone - {0}
            else:
                self._edit(first, next_key, "")
                gone = gone - set(range(stays))
        for index in gone:
            self._remove_lines(pairs[index][0].start_mark.index, self._end(pairs[index][1]))

    # --- lists

    def _sequence(self, key: yaml.Node, node: yaml.SequenceNode, gone: set[int], added: Sequence[Any]) -> None:
        """Edit a list.

        Args:
            gone: the indices of the entries that go.
        """
        if node.flow_style:
            self._flow_sequence(key, node, gone, added)
            return
        entries = node.value
        for at in gone:
            start, end = self._dash(node, at), self._last_line(node, at)
            self._remove_lines(start, end)
        stays = [at for at in range(len(entries)) if at not in gone]
        if not stays and not added:
            colon = self._text.index(":", key.end_mark.index) + 1
            self._edit(colon, colon, " []")
        new = "".join(self._newline + line for each in added for line in self._like_neighbours(node, stays, each))
        if stays:
            end = self._line_end(self._last_line(node, stays[-1]))
            self._edit(end, end, new)
        elif added:
            start = self._line_start(node.start_mark.index)
            self._edit(start, start, new.removeprefix(self._newline) + self._newline)

    def _like_neighbours(self, node: yaml.SequenceNode, stays: Sequence[int], value: Any) -> list[str]:
        """Return the lines of a new entry of a block list, in the style of the last one."""
        at = stays[-1] if stays else len(node.value) - 1
        last, dash = node.value[at], self._dash(node, at)
        column = node.start_mark.column
        same_line = self._line_start(dash) == self._line_start(last.start_mark.index)
        lead = "-" + " " * (last.start_mark.column - column - 1 if same_line else 1)
        if isinstance(last, yaml.MappingNode) and not last.flow_style and isinstance(value, dict):
            lines = [f"{key}: {inline(each)}" for key, each in value.items()]
        else:
            lines = [_spaced(inline(value), self._text[last.start_mark.index :])]
        indents = [" " * column + lead, *[" " * (column + len(lead))] * (len(lines) - 1)]
        apart = at > 0 and _BREAK.sub("\n", self._text[self._end(node.value[at - 1]) : dash]).count("\n\n")
        return [""] * bool(apart) + [indent + line for indent, line in zip(indents, lines, strict=True)]

    def _dash(self, node: yaml.SequenceNode, at: int) -> int:
        """Return the position of the dash of a block list's entry."""
        line = self._line(node.value[at].start_mark.index)
        column = node.start_mark.column
        # An entry may begin below its dash.
        while not _BLANKS.sub("", self._text[self._starts[line] : self._ends[line]], count=1).startswith("-"):
            line -= 1
        return self._starts[line] + column

    def _last_line(self, node: yaml.SequenceNode, at: int) -> int:
        """Return a position on the last line of a block list's entry, which may be a comment among its keys."""
        entry = node.value[at]
        end = self._end(entry)
        if not isinstance(entry, yaml.MappingNode) or entry.flow_style:
            return end
        column, line = entry.start_mark.column, self._line(end)
        for start, stop in zip(self._starts[line + 1 :], self._ends[line + 1 :], strict=True):
            content = self._text[start:stop]
            if not content.lstrip().startswith("#") or len(content) - len(content.lstrip()) < column:
                break
            end = stop
        return end

    def _flow_sequence(self, key: yaml.Node, node: yaml.SequenceNode, gone: set[int], added: Sequence[Any]) -> None:
        entries: list[yaml.Node] = node.value
        start, end = node.start_mark.index, node.end_mark.index
        stays = [at for at in range(len(entries)) if at not in gone]
        own_line = not self._text[self._line_start(key.start_mark.index) : key.start_mark.index].strip()
        if own_line and self._text[start:end] == "[]" and isinstance(added[0], dict):
            indent = " " * (key.start_mark.column + 2)  # an empty list becomes one with a line for each entry
            self._edit(self._text.index(":", key.end_mark.index) + 1, end, "")
            line_end = self._line_end(end)
            self._edit(line_end, line_end, "".join(f"{self._newline}{indent}- {inline(each)}" for each in added))
            return
        self._remove_flow([(each, each) for each in entries], gone)
        if not stays:
            self._edit(start + 1, start + 1, ", ".join(inline(each) for each in added))
        elif added:
            self._add_flow(entries[stays[-1]], added)

    def _add_flow(self, last: yaml.Node, added: Sequence[Any]) -> None:
        """Add entries behind the last one: on lines of their own where that one has its own."""
        end = self._end(last)
        new = [_spaced(inline(each), self._text[last.start_mark.index :]) for each in added]
        line_start, line_end = self._line_start(last.start_mark.index), self._line_end(end)
        indent, rest = self._text[line_start : last.start_mark.index], self._text[end:line_end].lstrip()
        if indent.strip() or not _REST_OF_LINE.match(rest.removeprefix(",")):
            self._edit(end, end, "".join(f", {each}" for each in new))
            return
        comma = "," if rest.startswith(",") else ""
        if not comma:
            self._edit(end, end, ",")
        lines = f",{self._newline}{indent}".join(new)
        self._edit(line_end, line_end, f"{self._newline}{indent}{lines}{comma}")

    def _remove_flow(self, items: Sequence[Pair], gone: set[int]) -> None:
        """Remove items from between brackets or braces, each with one comma."""
        last = max((index for index in range(len(items)) if index not in gone), default=None)
        if last is not None and last < len(items) - 1:
            start, end = self._end(items[last][1]), self._end(items[-1][1])
            if self._line(start) == self._line(end):
                self._edit(start, end, "")
                gone = {index for index in gone if index < last}
        for index in gone:
            start, end = items[index][0].start_mark.index, self._end(items[index][1])
            comma = re.compile(r"(\s|#.*)*,").match(self._text, end)
            end = comma.end() if comma else end
            line_start, line_end = self._line_start(start), self._line_end(end)
            if not self._text[line_start:start].strip() and _REST_OF_LINE.match(self._text[end:line_end]):
                self._remove_lines(start, end)
            else:
                blanks = _BLANKS.match(self._text, end)
                assert blanks is not None
                self._edit(start, blanks.end(), "")

    # --- positions

    def _edit(self, start: int, end: int, new: str) -> None:
        self._edits.append((start, end, new))

    def _remove_lines(self, start: int, end: int) -> None:
        """Remove every line from that of `start` to that of `end`."""
        first, last = self._line(start), self._line(end)
        after = self._starts[last + 1] if last + 1 < len(self._starts) else len(self._text)
        self._edit(self._starts[first], after, "")

    def _line(self, at: int) -> int:
        return bisect_right(self._starts, at) - 1

    def _line_start(self, at: int) -> int:
        return self._starts[self._line(at)]

    def _line_end(self, at: int) -> int:
        return self._ends[self._line(at)]

    def _end(self, node: yaml.Node) -> int:
        """Return the end of a node's own text. PyYAML's end of a block is where the next token begins."""
        if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
            last = node.value[-1]
            return self._end(last[1] if isinstance(last, tuple) else last)
        start, end = node.start_mark.index, node.end_mark.index
        return start + len(self._text[start:end].rstrip())


def _matched(before: Sequence[Entry], after: Sequence[Entry]) -> dict[int, int]:
    """Return the entries that stay, by their indices before and after.

    The `identity` of an entry tells which one it is. Where that changed, its place between its neighbours does.
    """
    places = {identity(each): to for to, each in enumerate(after)}
    matched = {at: places[identity(each)] for at, each in enumerate(before) if identity(each) in places}
    new_runs = _runs(after, set(matched.values()))
    for around, old_run in _runs(before, set(matched)).items():
        new_run = new_runs.get(around, [])
        if len(old_run) == len(new_run):
            matched |= zip(old_run, new_run, strict=True)
    return matched


def _runs(entries: Sequence[Entry], known: Set[int]) -> dict[tuple[Any, Any], list[int]]:
    """Return the runs of consecutive entries that are not known, by the identities of the known ones around each."""
    runs: dict[tuple[Any, Any], list[int]] = {}
    run: list[int] = []
    before = None
    for at, entry in enumerate(entries):
        if at not in known:
            run.append(at)
            continue
        if run:
            runs[before, identity(entry)] = run
        before, run = identity(entry), []
    if run:
        runs[before, None] = run
    return runs


def _spaced(mapping: str, like: str) -> str:
    """Return a mapping in braces, with blanks inside them where another has those."""
    return f"{{ {mapping[1:-1]} }}" if like.startswith("{ ") and mapping.startswith("{") else mapping
