"""A machine with the real kernel's Bluetooth, to run tests in.

QEMU without KVM boots Debian's kernel with two linked virtual controllers and BlueZ, runs a pytest selection with
Debian's Python 3.11 and the project's wheels, and hands back its output and exit code. `layers` makes what the machine
boots from, once; `machine` runs it. By hand: ``python -m tests.bluetooth.vm tests/bluetooth/guest -k scan``.
"""
