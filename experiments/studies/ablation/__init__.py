"""The ten conditioning mechanisms side by side: ``python -m experiments.studies.ablation``."""
