"""One parser under coverage-guided fuzzing, for some seconds: ``python -m tests.fuzz.coverage NAME SECONDS FOLDER``."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import atheris
from tests.fuzz.findings import Findings
from tests.fuzz.parser import LONGEST

_SLOW = 10
"""s that one input may take."""
_MEMORY = 2048
"""MB."""


def main(name: str, seconds: str, folder: Path) -> None:
    """Fuzz until the time is over; the fuzzer then ends the process."""
    with atheris.instrument_imports(include=["rsb_bridge", "yaml"]):
        from tests.fuzz.parsers import load_parsers

        parser = load_parsers()[name]
    corpus = folder / "corpus" / name
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(parser.seeds):
        (corpus / f"seed-{number}").write_bytes(seed)
    findings = Findings(folder / "findings", parser)

    def mutate(data: bytes, longest: int, seed: int) -> bytes:
        chance = random.Random(seed)
        if chance.randrange(2):
            return bytes(atheris.Mutate(data, longest))
        return parser.edit(data, chance)[:longest]

    options = (
        f"-max_total_time={seconds}", f"-max_len={LONGEST}", f"-timeout={_SLOW}", f"-rss_limit_mb={_MEMORY}",
        f"-artifact_prefix={folder / 'findings' / name}-", "-print_final_stats=1", "-verbosity=1",
    )  # fmt: skip
    corpora = [str(each) for each in (corpus, parser.corpus) if each.is_dir()]
    atheris.Setup([sys.argv[0], *options, *corpora], findings.read, custom_mutator=mutate)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
