"""The config autoencoder of scjax (scjax/train/configs/autoencoder.py), under the path that its commands name."""

from scjax.train.configs.autoencoder import get_config

__all__ = ["get_config"]
