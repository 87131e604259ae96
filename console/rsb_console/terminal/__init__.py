"""The terminal under the console: its driver, the clipboard, and signals that end the console."""
