"""The demo's simulated robot, its rooms, and its desk."""
