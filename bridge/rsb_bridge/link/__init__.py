"""One peer: connecting, authenticating, negotiating routes, keeping the connection alive."""
