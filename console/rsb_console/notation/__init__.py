"""Signs, and the formats of figures."""
