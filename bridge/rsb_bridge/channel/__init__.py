"""Channels, each for the messages of one route: over a stream, datagrams, or a share of a stream."""
