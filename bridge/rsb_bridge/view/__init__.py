"""Draws pictures of messages, in a process of its own."""
