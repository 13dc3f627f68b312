"""The config counts of scjax (scjax/train/configs/counts.py), under the path that its commands name."""

from scjax.train.configs.counts import get_config

__all__ = ["get_config"]
