"""The config denoiser of scjax (scjax/train/configs/denoiser.py), under the path that its commands name."""

from scjax.train.configs.denoiser import get_config

__all__ = ["get_config"]
