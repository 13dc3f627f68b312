"""Lanes of a log as roads with smooth curves, widths and junctions, for formats that have roads."""
