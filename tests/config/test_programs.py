"""Warnings of programs that other users can change or replace."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from rsb_bridge.config.programs import program_warnings

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """A program in a folder of its own, both of this user only."""
    path = tmp_path / "bin" / "restart-nav"
    path.parent.mkdir(mode=0o755)
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return path


def warnings(program: Path, folder: Path) -> list[str]:
    return list(program_warnings(str(program), folder / "robot1.yaml"))


def test_a_file_that_others_can_write_is_named(program: Path, tmp_path: Path) -> None:
    assert warnings(program, tmp_path) == []
    program.chmod(0o775)
    (warning,) = warnings(program, tmp_path)
    assert warning == f"other users can change {program}, which runs as this user: chmod go-w {program}"


def test_folders_above_count(program: Path, tmp_path: Path) -> None:
    program.parent.chmod(0o777)
    (warning,) = warnings(program, tmp_path)
    assert warning.endswith(f"chmod go-w {program.parent}")
    program.parent.chmod(0o1777)
    assert warnings(program, tmp_path) == [], "with the sticky bit, nobody can replace it"
    program.parent.chmod(0o755)
    tmp_path.chmod(0o777)
    assert warnings(program, tmp_path)[0].endswith(f"chmod go-w {tmp_path}")


def test_folders_of_a_link_and_its_target_count(program: Path, tmp_path: Path) -> None:
    link = tmp_path / "links" / "nav"
    link.parent.mkdir()
    link.symlink_to(program)
    for folder in (link.parent, program.parent):
        folder.chmod(0o777)
        (warning,) = warnings(link, tmp_path)
        assert warning.endswith(f"chmod go-w {folder}")
        folder.chmod(0o755)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_another_owner_is_named(program: Path, tmp_path: Path) -> None:
    os.chown(program, 4242, -1)
    (warning,) = warnings(program, tmp_path)
    assert f"{program} belongs to uid 4242" in warning
    os.chown(program, 0, -1)
    os.chown(program.parent, 4242, -1)
    (warning,) = warnings(program, tmp_path)
    assert f"{program.parent} belongs to uid 4242" in warning
