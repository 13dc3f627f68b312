"""A small driving policy, trained by PPO on synthetic worlds: ``python -m experiments.policy``."""
