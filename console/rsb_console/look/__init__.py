"""Themes, signs, and the formats of figures."""
