"""Real road shapes under an open license: the towns of CARLA, with traffic by SUMO; a source of records."""
