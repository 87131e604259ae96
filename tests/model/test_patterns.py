"""Patterns of names, held against a naive reference."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_bridge.model.names import is_topic_name
from rsb_bridge.model.patterns import Pattern, is_valid

SEGMENTS = st.text("ab_", min_size=1, max_size=4)
NAMES = st.lists(SEGMENTS, min_size=1, max_size=5).map(lambda parts: f"/{'/'.join(parts)}")
GLOBS = st.text("ab*", min_size=1, max_size=4).filter(lambda text: "**" not in text)
PATTERNS = st.lists(st.one_of(SEGMENTS, GLOBS, st.just("**")), min_size=1, max_size=5).map(
    lambda parts: f"/{'/'.join(parts)}"
)


def matches(pattern: str, name: str) -> bool:
    """Whether a name matches: every way is tried."""
    return _segments(pattern.split("/")[1:], name.split("/")[1:])


def _segments(pattern: list[str], name: list[str]) -> bool:
    if not pattern:
        return not name
    first, *rest = pattern
    if first == "**":
        least = 0 if rest else 1
        return any(_segments(rest, name[taken:]) for taken in range(least, len(name) + 1))
    return bool(name) and _characters(first, name[0]) and _segments(rest, name[1:])


def _characters(pattern: str, text: str) -> bool:
    if not pattern:
        return not text
    if pattern[0] == "*":
        return any(_characters(pattern[1:], text[taken:]) for taken in range(len(text) + 1))
    return bool(text) and text[0] == pattern[0] and _characters(pattern[1:], text[1:])


@given(PATTERNS, NAMES)
def test_a_pattern_matches_what_the_reference_says(pattern: str, name: str) -> None:
    parts = Pattern(pattern).match(name)
    assert (parts is not None) == matches(pattern, name)
    if parts is not None:
        assert Pattern(pattern).fill(parts) == name, "the texts of the wildcards make the name again"


@given(NAMES, st.data())
def test_a_pattern_made_of_a_name_matches_it(name: str, data: st.DataObject) -> None:
    """Names that match are seldom made by chance."""
    segments = name.split("/")[1:]
    for at, segment in enumerate(segments):
        kind = data.draw(st.sampled_from(["as it is", "*", "*_", "_*", "**"]))
        segments[at] = {"*": "*", "*_": f"*{segment[1:]}", "_*": f"{segment[:-1]}*", "**": "**"}.get(kind, segment)
    pattern = "/" + "/".join(segments)
    parts = Pattern(pattern).match(name)
    assert (parts is not None) == matches(pattern, name)
    assert parts is None or Pattern(pattern).fill(parts) == name


@pytest.mark.parametrize(
    ("pattern", "name", "parts"),
    [
        ("/camera/**", "/camera/left/image", ("left/image",)),
        ("/camera/**", "/camera", None),
        ("/camera/**", "/cameras/left", None),
        ("/camera/**/compressed", "/camera/compressed", ("",)),
        ("/camera/**/compressed", "/camera/left/image/compressed", ("left/image",)),
        ("/camera/*", "/camera/left/image", None),
        ("/camera/*", "/camera/left", ("left",)),
        ("/*/scan", "/robot1/scan", ("robot1",)),
        ("/scan*", "/scan", ("",)),
        ("/scan*", "/scan_raw", ("_raw",)),
        ("/**", "/a/b", ("a/b",)),
        ("/a.c", "/abc", None),
    ],
)
def test_what_the_documentation_says(pattern: str, name: str, parts: tuple[str, ...] | None) -> None:
    assert Pattern(pattern).match(name) == parts


@pytest.mark.parametrize(
    ("source", "target", "expected"),
    [("/*", "/robot1/*", "/robot1/scan"), ("/**", "/all/**/here", "/all/scan/here"), ("/sc*", "/*_x", "/an_x")],
)
def test_one_pattern_fills_another(source: str, target: str, expected: str) -> None:
    parts = Pattern(source).match("/scan")
    assert parts is not None
    assert Pattern(target).fill(parts) == expected


@given(PATTERNS)
def test_a_valid_pattern_can_match(pattern: str) -> None:
    if is_valid(pattern):
        filled = Pattern(pattern).fill(tuple("a" for _ in Pattern(pattern).wildcards))
        assert is_topic_name(filled)
        assert Pattern(pattern).match(filled) is not None


@pytest.mark.parametrize(
    "text", ["", "*", "**", "scan*", "/a**", "/**b", "/a//*", "/*/", "/1*", "/a b*", "/[ab]*", "/a?*"]
)
def test_what_can_match_no_name_is_no_pattern(text: str) -> None:
    assert not is_valid(text)


def test_no_name_takes_long() -> None:
    """No name makes a pattern try all ways to match, which would take forever."""
    patterns = [Pattern("/" + "*a" * 20 + "*b"), Pattern("/**/a" * 20 + "/b"), Pattern("/**/*a*a*a*" * 5 + "/b")]
    names = ["/" + "a" * 246, "/a" * 123, "/aaaa" * 49]
    assert [pattern.match(name) for pattern, name in itertools.product(patterns, names)] == [None] * 9
