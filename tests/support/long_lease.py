"""The times (s) of a lease for tests of other things: a busy machine may stand still for more than a second."""

# Not more than 5: a disarm waits for so long where the other side does not answer.
TIMES = {"LASTS": 5.0, "SLOW": 5.0, "GIVEN_UP_AFTER": 15.0}
