"""Earlier name of experiments/configs/counts.py."""

from scjax.train.configs.counts import get_config

__all__ = ["get_config"]
