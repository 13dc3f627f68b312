"""Maps that grow tile by tile: the known part of a window, candidates, seams, the next place."""
