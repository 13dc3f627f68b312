"""A procedural world without limits: streets, traffic, people and rare events, each scene labelled."""
