"""Files: sessions, their validation, keys, and the import of the thesis's configuration."""
