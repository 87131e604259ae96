"""What ``doctor`` finds out about the process that draws."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Finding, Grade, Wording

if TYPE_CHECKING:
    from collections.abc import Iterator

_WITHIN = 20.0  # s; a slow computer starts Python for seconds


class ConfinementText(Wording):
    """Findings about the process that draws, and remedies."""

    CONFINED = "the process that draws reads only the program's files, and reaches nothing else"
    DRAWS_WITH_FILES = "the process that draws can read its user's files and processes: this kernel has no Landlock"
    DRAWS_WITH_NETWORK = "the process that draws has a network, so it could drive robots: no seccomp filter here"
    LANDLOCK_REMEDY = "Linux 5.13 or newer with Landlock (boot parameter lsm=landlock,...)"
    FILTER_REMEDY = "a kernel with seccomp (CONFIG_SECCOMP_FILTER), on x86-64 or aarch64"


def confined() -> Iterator[Finding]:
    """Have a process confine itself as the one that draws does."""
    # A process of its own, because no measure can be undone.
    trial = (sys.executable, "-P", "-m", "rsb_extras.pictures.confinement")
    try:
        ran = subprocess.run(trial, capture_output=True, timeout=_WITHIN, check=True)  # noqa: S603 -- own program
    except subprocess.SubprocessError as error:
        raise OSError(str(error)) from error
    facts = json.loads(ran.stdout)
    remedy = ""
    if not (facts["no_new_privileges"] and facts["no_capabilities"]):
        text = "the process that draws keeps root's rights, or can gain some"
        remedy = "run the bridge as a user of its own, not as root"
    elif not facts["filtered"]:
        text, remedy = ConfinementText.DRAWS_WITH_NETWORK(), ConfinementText.FILTER_REMEDY()
    elif not facts["landlock"]:
        text, remedy = ConfinementText.DRAWS_WITH_FILES(), ConfinementText.LANDLOCK_REMEDY()
    else:
        text = ConfinementText.CONFINED()
    yield Finding("pictures", Grade.NOTE if remedy else Grade.OK, "pictures", text, remedy, facts)
