"""Runs the parsers of fuzzing for seconds with Hypothesis, under the same conditions."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fuzz.parser import CORPUS, LONGEST
from tests.fuzz.parsers import load_parsers

PARSERS = load_parsers()
KEPT = [path for parser in PARSERS.values() for path in parser.kept()]


@pytest.mark.parametrize("name", PARSERS)
def test_what_is_right_is_read(name: str) -> None:
    for seed in PARSERS[name].seeds:
        PARSERS[name].read(seed)


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_what_was_found_once_is_read(path: Path) -> None:
    PARSERS[path.parent.name].read(path.read_bytes())


@pytest.mark.parametrize("name", PARSERS)
@settings(deadline=None, database=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), random=st.randoms(use_true_random=False))
def test_anything_is_read_or_refused(name: str, data: st.DataObject, random: Random) -> None:
    parser = PARSERS[name]
    known = [*parser.seeds, *(path.read_bytes() for path in parser.kept())]
    content = data.draw(st.one_of(st.sampled_from(known), st.binary(max_size=100)))
    for _ in range(data.draw(st.integers(0, 4))):
        content = parser.edit(content, random)
    parser.read(content[:LONGEST])


def test_every_corpus_belongs_to_parser_and_is_small() -> None:
    folders = {
        path
        for corpora in {each.corpora for each in PARSERS.values()} | {CORPUS}
        if corpora.is_dir()
        for path in corpora.iterdir()
    }
    assert folders <= {each.corpus for each in PARSERS.values()}
    for parser in PARSERS.values():
        assert sum(path.stat().st_size for path in parser.kept()) <= 8192
