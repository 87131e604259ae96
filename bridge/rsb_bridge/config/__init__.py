"""Files: sessions, their validation, and keys."""
