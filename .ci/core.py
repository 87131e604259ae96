"""Makes ``build/core``: this tree without its features, in an environment without them (``make test-core``).

The environment is the one that is given, in symbolic links, with this project's metadata and path replaced.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

CORE = Path("build/core").absolute()
KEPT = {".mypy_cache", ".import_linter_cache", "__pycache__"}
"""Caches. Files are copied with their times, so that bytecode of those that have not changed stays valid."""
FEATURES = "extras/"
USERS = "bench/"
"""The developers' benchmarks, which use the feature for benchmarks."""
ENTRY_POINTS = re.compile(r"\[rsb_console\.feature\]\n(?:[^\[\n].*\n|\n)*")


def main(environment: Path) -> None:
    CORE.mkdir(parents=True, exist_ok=True)
    for name in (".git", ".venv"):
        shutil.rmtree(CORE / name, ignore_errors=True)
    clear(CORE)
    copy_tree()
    copy_environment(environment, CORE / ".venv")


def clear(folder: Path) -> None:
    """Delete all files of a folder but caches."""
    for each in folder.iterdir():
        if each.name in KEPT:
            continue
        if each.is_dir() and not each.is_symlink():
            clear(each)
        else:
            each.unlink()


def copy_tree() -> None:
    """Copy all files that git knows or would add, without features, and take them out of pyproject.toml."""
    listed = ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
    names = subprocess.run(listed, capture_output=True, text=True, check=True).stdout.split("\0")
    for name in filter(None, names):
        if not name.startswith((FEATURES, USERS)) and os.path.lexists(name):
            (CORE / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(name, CORE / name, follow_symlinks=False)
    settings = CORE / "pyproject.toml"
    text = settings.read_text(encoding="utf-8")
    for lists in (', "rsb_extras"', ', "extras/rsb_extras"', ', "bench"'):
        assert lists in text
        text = text.replace(lists, "")
    text = re.sub(r'^  "rsb_extras\..*\n', "", text, flags=re.MULTILINE)  # what contracts allow them
    # Some tests and pictures use features where these are installed.
    text += '\n[[tool.mypy.overrides]]\nmodule = "rsb_extras.*"\nignore_missing_imports = true\n'
    settings.write_text(text, encoding="utf-8")
    # What git lists of a tree is asked by tests, and the tree is in another one.
    subprocess.run(("git", "init", "-q", CORE), check=True)
    subprocess.run(("git", "-C", CORE, "add", "."), check=True)


def link(old: Path, new: Path, own: set[Path]) -> None:
    """Link the entries of a folder, and those of the folders in it that are the copy's own."""
    new.mkdir()
    for each in old.iterdir():
        if each in own:
            link(each, new / each.name, own)
        else:
            (new / each.name).symlink_to(each.readlink() if each.is_symlink() else each)


def copy_environment(old: Path, new: Path) -> None:
    (metadata,) = old.absolute().glob("lib/python*/site-packages/rsb_console-*.dist-info")
    link(old.absolute(), new, {old.absolute() / "bin", metadata, *metadata.parents})
    (packages,) = new.glob("lib/python*/site-packages")
    (path,) = packages.glob("_editable_impl_rsb_console.pth")
    (entries,) = packages.glob("rsb_console-*.dist-info/entry_points.txt")
    script, stamp = new / "bin/rsb-console", new / ".installed"
    replaced = {
        path: f"{CORE}/bridge\n{CORE}/console\n",
        entries: ENTRY_POINTS.sub("", entries.read_text(encoding="utf-8")),
        script: re.sub(r"\A#!.*", f"#!{new}/bin/python", script.read_text(encoding="utf-8")),
        stamp: "",
    }
    for file, text in replaced.items():
        file.unlink(missing_ok=True)  # a link to the other environment's
        file.write_text(text, encoding="utf-8")
    script.chmod(0o755)
    lacks = "from importlib import util; from rsb_bridge.installed_features import installed; "
    lacks += "assert util.find_spec('rsb_extras') is None; assert not installed()"
    subprocess.run((new / "bin/python", "-P", "-c", lacks), check=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
