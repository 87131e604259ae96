"""What doctor says about the process that draws."""

from __future__ import annotations

import json
import subprocess
import sys
from types import SimpleNamespace

import pytest
from tests.system.confined_helpers import ROOT, has_seccomp
from tests.system.confined_helpers import confined as in_the_unit

from rsb_bridge.model.finding import Grade
from rsb_extras.pictures.confinement_check import confined
from rsb_extras.pictures.tests import picture_places


@pytest.mark.parametrize(
    ("rights", "landlock", "filtered", "grade"),
    [
        (False, 7, True, Grade.OK), (False, 1, True, Grade.OK), (False, 7, False, Grade.NOTE),
        (False, 0, True, Grade.NOTE), (False, 0, False, Grade.NOTE), (True, 0, True, Grade.NOTE),
    ],
)  # fmt: skip
def test_how_the_process_that_draws_is_confined(
    rights: bool, landlock: int, filtered: bool, grade: Grade, monkeypatch: pytest.MonkeyPatch
) -> None:
    facts = {"no_new_privileges": True, "no_capabilities": not rights, "landlock": landlock, "filtered": filtered}
    ran = SimpleNamespace(stdout=json.dumps(facts))
    picture_places.TRIAL.set(monkeypatch, lambda *_, **__: ran)
    (finding,) = confined()
    assert (finding.grade, bool(finding.remedy), finding.facts) == (grade, grade != Grade.OK, facts)


def test_the_confinement_is_tried_on_this_machine() -> None:
    (finding,) = confined()
    assert finding.facts["no_new_privileges"]
    assert finding.facts["no_capabilities"]


@pytest.mark.skipif(not has_seccomp(), reason="systemd-analyze and libseccomp are not installed")
def test_the_process_that_draws_confines_itself_further() -> None:
    """The unit's filter lets Landlock and another filter through, where the kernel has them."""
    trial = (sys.executable, "-P", "-m", "rsb_extras.pictures.confinement")
    free = subprocess.run(trial, cwd=ROOT, capture_output=True, text=True, timeout=120, check=True).stdout
    assert json.loads(in_the_unit(*trial).stdout) == json.loads(free)
