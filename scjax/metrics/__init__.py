"""Metrics over scenes: host-side NumPy, one concept a file, each a per-scene function whose results pool by sums."""
