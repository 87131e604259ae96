"""Signs, the formats of figures, and pictures as rows."""
