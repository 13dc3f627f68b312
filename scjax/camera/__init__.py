"""What a camera at the ego sees of a scene."""
