"""The terminal under the console: its driver, the clipboard, and its keys, in order and in time."""
