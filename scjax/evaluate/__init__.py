"""Measures any set of scenes, ours, another model's or recorded ones, beside floors and baselines (``--help``)."""
