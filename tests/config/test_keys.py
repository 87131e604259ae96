"""Key files are Fernet's, and nothing but the file ever shows a key."""

import base64
import os
from pathlib import Path

import pytest
from cryptography.fernet import Fernet
from tests.support import surroundings
from tests.support.wording import pattern, says

from rsb_bridge.config.keys import (
    Age,
    Key,
    KeyFileError,
    KeyFileProblem,
    KeyWarning,
    fingerprint,
    generate,
    is_key,
    key_warnings,
    read_key,
    write_key,
    written,
)

DAY = 86400


def test_a_key_is_one_that_fernet_takes(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    key = write_key(path)
    text = path.read_text().strip()
    assert Fernet(text).decrypt(Fernet(text).encrypt(b"scan")) == b"scan"
    assert read_key(path) == key
    assert len(key.secret) == 32
    assert key.warnings == ()
    assert path.stat().st_mode & 0o777 == 0o600
    assert generate() != generate()


def test_thesis_key_file_with_its_date_is_read(tmp_path: Path) -> None:
    """Its generate_key.py wrote a line with the date, an empty one, and the key without a line's end."""
    path = tmp_path / "key.txt"
    key = Fernet.generate_key().decode()
    path.write_text(f"Key generated at 01/06/2021 12:00:00:\n\n{key}")
    plain = tmp_path / "plain.txt"
    plain.write_text(key)
    assert read_key(path) == read_key(plain)


def test_key_file_is_never_overwritten_unless_told_to(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    old = write_key(path)
    with pytest.raises(KeyFileError, match=pattern(KeyFileProblem.EXISTS, path=path)):
        write_key(path)
    assert read_key(path) == old
    assert write_key(path, force=True) != old
    assert path.stat().st_mode & 0o777 == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_dangling_link_is_not_followed_by_new_key(tmp_path: Path) -> None:
    link = tmp_path / "key.txt"
    link.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(KeyFileError, match=pattern(KeyFileProblem.EXISTS, path=link)):
        write_key(link)
    assert not (tmp_path / "elsewhere").exists()


def test_a_key_never_shows_itself(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    key = write_key(path)
    text = path.read_text().strip()
    for shown in (repr(key), str(key), f"{key}", repr({"key": key})):
        assert text not in shown
        assert key.secret.hex() not in shown
        assert repr(key.secret) not in shown
        assert fingerprint(key) in shown


def test_a_fingerprint_is_the_start_of_the_sha256(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    path.write_text("OLTmUuRNp_I3DZ4mDicTZVCko6bQf1wMMy-LEiQIP9I=\n")
    # as sha256sum prints it
    assert fingerprint(read_key(path)) == "ea43 1b01 33d7 512f"


def test_key_that_others_can_read_comes_with_warning(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    write_key(path)
    path.chmod(0o640)
    (warning,) = read_key(path).warnings
    assert says(warning, KeyWarning.READABLE, path=path, mode="0640")


def test_key_that_others_can_replace_comes_with_warning(tmp_path: Path) -> None:
    folder = tmp_path / "open"
    folder.mkdir()
    write_key(folder / "key.txt")
    link = tmp_path / "key.txt"
    link.symlink_to(folder / "key.txt")
    assert read_key(link).warnings == ()
    folder.chmod(0o777)
    for path in (link, folder / "key.txt"):
        (warning,) = read_key(path).warnings
        assert says(warning, KeyWarning.REPLACEABLE, path=path, folder=folder)
    folder.chmod(0o1777)
    assert read_key(link).warnings == (), "as in /tmp: only its owner replaces a file there"


def test_key_of_another_user_comes_with_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "key.txt"
    write_key(path)
    owner = path.stat().st_uid
    for user, warned in ((owner, False), (0, False), (owner + 1, owner != 0)):
        surroundings.set_user(monkeypatch, user)
        assert any(says(text, KeyWarning.OTHER_OWNER, uid=owner) for text in read_key(path).warnings) == warned


NOW = 1_763_700_000.0


def test_whose_two_keys_an_operator_should_look_at() -> None:
    old, new = Key(bytes(32), written=NOW - 9 * DAY), Key(bytes(range(32)), written=NOW - 8 * DAY)
    recent, risky = Key(new.secret, written=NOW - 6 * DAY), Key(old.secret, ("mode 0644",), NOW)
    valid: dict[str, tuple[Key, ...]] = {
        "plain": (), "one": (old,), "begun": (old, recent), "long": (old, new), "same": (old, old), "risky": (risky,),
        "too": (risky, recent),
    }  # fmt: skip
    first, long, same = key_warnings(valid, NOW)
    assert first == "mode 0644"
    assert says(long, KeyWarning.TWO_FOR_LONG, name="long", since=written(new, NOW))
    assert Age.AGO(count=8, unit="days") in long
    assert says(same, KeyWarning.SAME_NEXT, name="same", fingerprint=fingerprint(old))


@pytest.mark.parametrize(
    ("seconds", "age"),
    [
        (0, Age.NOW()),
        (-3, Age.NOW()),
        (-61, Age.FUTURE()),
        (60, Age.AGO(count=1, unit="minute")),
        (7_300, Age.AGO(count=2, unit="hours")),
        (1.5 * 86400, Age.AGO(count=1, unit="day")),
    ],
)
def test_when_a_key_was_written(seconds: float, age: str) -> None:
    assert written(Key(bytes(32), written=NOW - seconds), NOW).endswith(f" ({age})")


def test_a_keys_file_says_when_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    write_key(path)
    os.utime(path, (NOW, NOW))
    assert read_key(path).written == NOW


@pytest.mark.parametrize(
    ("content", "code", "parameters"),
    [
        (b"", KeyFileProblem.EMPTY, {}),
        (b"\n \n", KeyFileProblem.EMPTY, {}),
        (b"too-short", KeyFileProblem.NO_KEY, {"length": 9}),
        (b"k" * 43, KeyFileProblem.NO_KEY, {"length": 43}),
        (b"A" * 64 + b"\n", KeyFileProblem.NO_KEY, {"length": 64}),
        (b"!" * 44, KeyFileProblem.NO_KEY, {"length": 44}),
        (b"\xff" * 44, KeyFileProblem.NO_KEY, {"length": 44}),
        (b"A" * 5000, KeyFileProblem.TOO_LARGE, {}),
        (b"A" * 43 + b"=", KeyFileProblem.WEAK, {"count": 1}),
        (base64.urlsafe_b64encode(b"ab" * 16), KeyFileProblem.WEAK, {"count": 2}),
        (base64.urlsafe_b64encode(bytes(range(11)) + bytes(21)), KeyFileProblem.WEAK, {"count": 3}),
        (base64.urlsafe_b64encode(bytes(range(32))), KeyFileProblem.WEAK, {"count": 1}),
        (base64.urlsafe_b64encode(bytes(range(255, 223, -1))), KeyFileProblem.WEAK, {"count": 1}),
        (base64.urlsafe_b64encode(bytes(each % 256 for each in range(200, 456, 8))), KeyFileProblem.WEAK, {"count": 1}),
        (base64.urlsafe_b64encode(bytes(range(16)) * 2), KeyFileProblem.WEAK, {"count": 2}),
    ],
)
def test_file_without_key_is_refused_and_not_quoted(
    tmp_path: Path, content: bytes, code: KeyFileProblem, parameters: dict[str, int]
) -> None:
    path = tmp_path / "key.txt"
    path.write_bytes(content)
    with pytest.raises(KeyFileError) as caught:
        read_key(path)
    assert says(caught.value, code, path=path, **parameters)
    assert len(content.strip()) < 5 or content.decode("ascii", "replace").strip() not in str(caught.value)


def test_passphrase_in_place_of_key_comes_with_warning(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    write_key(path)
    path.write_bytes(base64.urlsafe_b64encode(b"correct horse battery staple, 42"))
    (warning,) = read_key(path).warnings
    assert says(warning, KeyWarning.PRINTABLE, path=path)
    path.write_bytes(base64.urlsafe_b64encode(b"correct horse battery staple, 4\x80"))
    assert not read_key(path).warnings


def test_files_that_cannot_be_are_named(tmp_path: Path) -> None:
    with pytest.raises(KeyFileError, match=pattern(KeyFileProblem.NO_SUCH_FILE, path=tmp_path / "key.txt")):
        read_key(tmp_path / "key.txt")
    with pytest.raises(KeyFileError, match=pattern(KeyFileProblem.NOT_A_FILE, kind="a folder")):
        read_key(tmp_path)
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(KeyFileError, match=pattern(KeyFileProblem.NOT_A_FILE, kind="a FIFO")):
        read_key(tmp_path / "fifo")
    with pytest.raises(KeyFileError, match=pattern(KeyFileProblem.NOT_A_FILE, kind="a device")):
        read_key(Path("/dev/null"))
    with pytest.raises(KeyFileError, match="cannot be written: No such file or directory"):
        write_key(tmp_path / "folder" / "key.txt")


def test_a_file_name_is_no_key() -> None:
    assert is_key(generate().decode())
    assert not any(map(is_key, ["key.txt", "", "é" * 44, "A" * 44]))
