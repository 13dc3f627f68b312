"""Autoencoder: scene tokens <-> one latent per agent and lane."""

from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.model import Autoencoder, autoencoder, noise_like
from scjax.models.autoencoder.outputs import Decoded, Posterior, reparameterize

__all__ = ["Autoencoder", "AutoencoderConfig", "Decoded", "Posterior", "autoencoder", "noise_like", "reparameterize"]
