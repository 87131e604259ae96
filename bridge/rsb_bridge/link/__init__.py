"""One peer: connecting, admitting, negotiating routes, keeping the connection alive."""
