"""The learned behavior: a transformer that reads the surroundings of an agent and gives its next motion."""
