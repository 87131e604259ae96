#!/usr/bin/env bash
# pip installs a package whose program may not be run.
#
# rosbridge-server-rs 0.1.6 with pip 26.1, from PyPI. The wheel's entry of the program has the permissions 0755 without the
# bits that say "a regular file". unzip gives these permissions; pip gives them to regular files only, and so 0644. The
# command of the package ends with a PermissionError; `chmod +x` of the file that it names helps.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple pip==26.1
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple rosbridge-server-rs==0.1.6
venv/bin/pip download -q --no-deps --index-url https://pypi.org/simple rosbridge-server-rs==0.1.6

cat >program.py <<'PYTHON'
import os
import subprocess
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path

import rosbridge_server_rs

print("rosbridge-server-rs", version("rosbridge-server-rs"), "pip", version("pip"))
name = "rosbridge_server_rs_jazzy"
(wheel,) = Path().glob("*.whl")
print("in the wheel:", oct(zipfile.ZipFile(wheel).getinfo(f"rosbridge_server_rs/{name}").external_attr >> 16))
print("installed:", oct(Path(rosbridge_server_rs.__file__).with_name(name).stat().st_mode))
command = Path(sys.executable).with_name("rosbridge_server_rs")
ran = subprocess.run([command, "--help"], env=os.environ | {"ROS_DISTRO": "jazzy"}, capture_output=True, text=True)
print(ran.stderr.splitlines()[-1])
PYTHON

cat >expected <<'TEXT'
rosbridge-server-rs 0.1.6 pip 26.1
in the wheel: 0o755
installed: 0o100644
PermissionError: [Errno 13] Permission denied
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
