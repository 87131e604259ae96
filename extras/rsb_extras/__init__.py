"""This project's features, one folder each (docs/a-feature.md)."""
