"""The operators of a session: who is refused in its file, and whose keys must not be the same."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from tests.config.mistakes import CLIENT, FILE, problems

from rsb_bridge.config.keys import Key, KeyFileError, copy_key, key_users, unshared_keys, write_key
from rsb_bridge.config.operator_keys import Granted, granted_operators, operator_changes
from rsb_bridge.config.session_file import dump, load_file, parse, save, validate
from rsb_bridge.model.limits import OPERATORS
from rsb_bridge.model.session import Operator, Session

ANNA = Operator("anna", "anna.key", "take")
BOB = Operator("bob", "bob.key")


def with_operators(*operators: Operator) -> Session:
    return msgspec.structs.replace(parse(CLIENT, FILE), operators=operators)


def test_operators_are_read_and_written() -> None:
    text = (
        f"{CLIENT}operators:\n  - {{name: anna, key_file: anna.key, may: take}}\n  - {{name: bob, key_file: bob.key}}\n"
    )
    session = parse(text, FILE)
    assert session.operators == (ANNA, BOB)
    assert BOB.may == "look"
    assert parse(dump(session), FILE) == session


@pytest.mark.parametrize(
    ("entry", "location"),
    [
        ("{name: anna}", "operators[0].key_file"),
        ("{key_file: anna.key}", "operators[0].name"),
        ("{name: anna, key_file: ''}", "operators[0].key_file"),
        ("{name: '', key_file: anna.key}", "operators[0].name"),
        (f"{{name: {'a' * 256}, key_file: anna.key}}", "operators[0].name"),
        ("{name: anna, key_file: anna.key, may: everything}", "operators[0].may"),
        ("{name: anna, key_file: anna.key, key: x}", "operators[0].key"),
        ("{name: anna, key_file: a.key}, {name: anna, key_file: b.key}", "operators[1].name"),
        (", ".join(f"{{name: a{n}, key_file: a.key}}" for n in range(OPERATORS + 1)), "operators"),
        (f"{{name: anna, key_file: {'a' * 43}=}}", "operators[0].key_file"),
    ],
)
def test_mistakes_name_their_place(entry: str, location: str) -> None:
    (problem,) = problems(f"{CLIENT}operators: [{entry}]\n")
    assert (problem.location, problem.line) == (location, 6)


def test_as_many_as_there_may_be() -> None:
    assert validate(with_operators(*(Operator(f"a{n}", "a.key") for n in range(OPERATORS)))) == []


def test_a_save_keeps_what_is_said_of_operators(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(f"{CLIENT}operators:  # the shift\n  - name: anna  # by day\n    key_file: anna.key\n")
    opened = load_file(path)
    changed = msgspec.structs.replace(opened.session, stale_after=3.0)
    save(changed, path, opened)
    assert "# by day" in path.read_text()
    assert load_file(path).session.operators == opened.session.operators
    more = msgspec.structs.replace(changed, operators=(*changed.operators, BOB))
    save(more, path, load_file(path))
    assert "# by day" in path.read_text()
    assert load_file(path).session == more
    none = msgspec.structs.replace(more, operators=())
    save(none, path, load_file(path))
    assert load_file(path).session == none


def test_each_has_a_key_of_their_own(tmp_path: Path) -> None:
    link = write_key(tmp_path / "key.txt")
    anna, bob = write_key(tmp_path / "anna.key"), write_key(tmp_path / "bob.key")
    session = with_operators(ANNA, BOB)
    keys = unshared_keys(session, tmp_path)
    assert granted_operators(session, tmp_path, keys) == {"anna": Granted(ANNA, anna), "bob": Granted(BOB, bob)}
    for other in (link, anna):
        copy_key(other, tmp_path / "bob.key", force=True)
        with pytest.raises(KeyFileError, match="operator bob"):
            granted_operators(session, tmp_path, keys)


@pytest.mark.parametrize("content", [None, b"", b"no key"])
def test_a_key_that_cannot_be_read_is_said(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "anna.key").write_bytes(content)
    with pytest.raises(KeyFileError, match=r"anna\.key"):
        granted_operators(with_operators(ANNA), tmp_path, {})


def test_the_keys_are_listed_with_the_others() -> None:
    assert set(key_users(with_operators(ANNA))) == {"key.txt", "anna.key"}


def test_what_differs_is_said_for_each() -> None:
    one, other = Key(b"1" * 32), Key(b"2" * 32)
    before = {"anna": Granted(ANNA, one), "bob": Granted(BOB, other), "carl": Granted(BOB, one)}
    look = msgspec.structs.replace(ANNA, may="look")
    after = {"anna": Granted(look, one), "bob": Granted(BOB, one), "dora": Granted(BOB, other)}
    assert [text.partition(":")[0] for text in operator_changes(before, after)] == [
        "operator carl", "operator anna", "operator bob", "operator dora",
    ]  # fmt: skip
    assert operator_changes(before, before) == []
