"""Maps that grow tile by tile: known half, candidates, seam, next place (design of the paper's outpainting)."""
