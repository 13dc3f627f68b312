"""What a scene shows, as facts and as sentences: rules on lanes and boxes, no model."""
