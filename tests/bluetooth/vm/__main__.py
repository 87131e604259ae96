"""``python -m tests.bluetooth.vm [--kernel VERSION] PYTEST-ARGUMENT...``: runs them in the machine."""

from __future__ import annotations

import argparse
import sys

from tests.bluetooth.vm import debian, layers, machine


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="bluetooth-vm", description="Run pytest in a machine with two Bluetooth adapters."
    )
    parser.add_argument("--kernel", help="Debian's kernel to boot, as in uname -r", default=None)
    parser.add_argument("--console", action="store_true", help="show the kernel's console as well")
    own, selection = parser.parse_known_args()
    try:
        (outcome,) = machine.run(layers.prepare((own.kernel,) if own.kernel else debian.KERNELS), selection)
    except (debian.UnavailableError, machine.DiedError) as error:
        sys.stderr.write(f"{error}\n")
        return 125
    sys.stdout.write(outcome.output)
    if own.console:
        sys.stderr.write(outcome.console)
    return outcome.exit_code


if __name__ == "__main__":
    sys.exit(main())
