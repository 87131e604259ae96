"""The console in a real terminal, on an engine that plays a script: ``python -m tests.console.scripted_console``."""

import sys
from pathlib import Path
from typing import Any

from tests.console.driving import scripted_app
from tests.console.scripted import SESSION

_NOTES_STAY = 1e6
"""s. A slow machine may take longer to look at the screen than a note stays there otherwise, 5 s."""

if __name__ == "__main__":
    options: dict[str, Any] = {"session": None, "path": None} if "--empty" in sys.argv else {"session": SESSION}
    app = scripted_app(**{"path": Path("nav2.yaml"), **options})
    type(app).NOTIFICATION_TIMEOUT = _NOTES_STAY
    app.run()
