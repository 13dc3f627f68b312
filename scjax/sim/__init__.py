"""Traffic over time: road networks, behavior models and roll-outs."""
