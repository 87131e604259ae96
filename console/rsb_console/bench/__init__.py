"""What a link carries, measured: how it is measured, what comes of it, and how that is shown."""
