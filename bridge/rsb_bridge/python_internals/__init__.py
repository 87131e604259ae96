"""Private parts of Python's own library. They are used here alone; `tests/checks/test_internals.py` tests each."""
