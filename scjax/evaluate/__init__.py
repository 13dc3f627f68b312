"""Compares sets of scenes (a model's, other models', recorded ones) with reference scenes, floors and baselines."""
