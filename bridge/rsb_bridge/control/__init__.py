"""Serving a running engine on a Unix socket of this machine, and attaching to one."""
