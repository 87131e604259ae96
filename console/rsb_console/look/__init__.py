"""How things look: themes, signs, and figures in words."""
