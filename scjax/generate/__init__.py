"""From a condition to scenes: read ``sample.py`` from top to bottom."""
