"""Turns configurations of other bridges into sessions: one module a bridge, and `importing` tells whose a file is."""
