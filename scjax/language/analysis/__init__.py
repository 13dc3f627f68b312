"""What lanes and boxes of one scene show, worked out once: ``scene_analysis.Analysis``. Attributes read it."""
