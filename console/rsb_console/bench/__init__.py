"""Benchmarks of links: the measurements, their results and the presentation."""
