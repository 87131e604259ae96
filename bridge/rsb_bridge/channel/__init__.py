"""What carries the messages of one route: a stream, datagrams, or a share of a stream."""
