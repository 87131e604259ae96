"""Private parts of argparse, Textual, rich and textual-image.

They are used here alone; `tests/checks/test_internals.py` tests each.
"""
