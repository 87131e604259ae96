"""The operator console and command line of rsb-console."""
