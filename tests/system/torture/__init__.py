"""Real programs under attack: whether anything unmeant or old reaches a robot, counted outside of them."""
