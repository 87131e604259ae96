"""Key files are Fernet's, and nothing but the file ever shows a key."""

import os
from pathlib import Path

import pytest
from cryptography.fernet import Fernet

from rsb_bridge.config.keys import KeyFileError, fingerprint, generate, is_key, read_key, write_key


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


def test_a_key_of_fernets_is_read(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    path.write_bytes(Fernet.generate_key())
    assert len(read_key(path).secret) == 32


def test_the_thesis_key_file_with_its_date_is_read(tmp_path: Path) -> None:
    """As its generate_key.py wrote it: a line with the date, an empty one, the key without a line's end."""
    path = tmp_path / "key.txt"
    key = Fernet.generate_key().decode()
    path.write_text(f"Key generated at 01/06/2021 12:00:00:\n\n{key}")
    plain = tmp_path / "plain.txt"
    plain.write_text(key)
    assert read_key(path) == read_key(plain)


def test_a_key_file_is_never_overwritten_unless_told_to(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    old = write_key(path)
    with pytest.raises(KeyFileError, match=r"exists already.*--force"):
        write_key(path)
    assert read_key(path) == old
    assert write_key(path, force=True) != old
    assert path.stat().st_mode & 0o777 == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_a_dangling_link_is_not_followed_by_a_new_key(tmp_path: Path) -> None:
    link = tmp_path / "key.txt"
    link.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(KeyFileError, match="exists already"):
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
    path.write_text("AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA=\n")
    # sha256 of 32 zero bytes, as sha256sum prints it
    assert "66687aadf862bd776c8fc18b8e9f8e20".startswith(fingerprint(read_key(path)).replace(" ", ""))
    assert fingerprint(read_key(path)) == "6668 7aad f862 bd77"


def test_a_key_that_others_can_read_comes_with_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    write_key(path)
    path.chmod(0o640)
    (warning,) = read_key(path).warnings
    assert "mode 0640" in warning
    assert f"chmod 600 {path}" in warning


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\n \n", "is empty"),
        (b"too-short", "has 9 characters"),
        (b"k" * 43, "has 43 characters"),
        (b"A" * 64 + b"\n", "has 64 characters"),
        (b"!" * 44, "holds no key"),
        (b"\xff" * 44, "holds no key"),
        (b"A" * 5000, "too large"),
    ],
)
def test_what_is_no_key_is_refused_in_words_that_do_not_quote_it(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "key.txt"
    path.write_bytes(content)
    with pytest.raises(KeyFileError) as caught:
        read_key(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)
    assert len(content.strip()) < 5 or content.decode("ascii", "replace").strip() not in str(caught.value)


def test_files_that_cannot_be_are_named(tmp_path: Path) -> None:
    with pytest.raises(KeyFileError, match=r"no such key file.*rsb-console keygen"):
        read_key(tmp_path / "key.txt")
    with pytest.raises(KeyFileError, match="is a folder, not a key file"):
        read_key(tmp_path)
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(KeyFileError, match="is a FIFO, not a key file"):
        read_key(tmp_path / "fifo")
    with pytest.raises(KeyFileError, match="is a device, not a key file"):
        read_key(Path("/dev/null"))
    with pytest.raises(KeyFileError, match="cannot be written: No such file or directory"):
        write_key(tmp_path / "folder" / "key.txt")


def test_a_file_name_is_no_key() -> None:
    assert is_key(generate().decode())
    assert not any(map(is_key, ["key.txt", "", "é" * 44, "A" * 44]))
