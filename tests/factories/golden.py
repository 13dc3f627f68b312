"""Reading golden vectors: a file that is not there skips the test, naming it; scenes are padded into one batch."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.denoiser.context import ImageFeatures, TextFeatures
from scjax.nn.cross_attention import CrossGlobalOptions
from scjax.scene.per_type import PerType

# The networks are tiny and their programs large: most of a test's time is spent in the compiler.
_QUICK = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
jit = functools.partial(jax.jit, compiler_options=_QUICK)


def load(folder: Path, name: str) -> dict[str, np.ndarray]:
    """All arrays of one file."""
    path = folder / name
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    with np.load(path) as data:
        return dict(data)


def config_of(folder: Path) -> dict:
    """Sizes of this set of vectors."""
    path = folder / "config.json"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    return json.loads(path.read_text())


def denoiser_config(folder: Path, kind: str) -> DenoiserConfig:
    """The official architecture at the sizes of this set; kind is uncond, text or image."""
    config = config_of(folder)
    sizes, limits = config["denoiser"], config["autoencoder"]
    rows, columns = sizes["image"]["grid"]
    image = ImageCondition(
        channels=sizes["image"]["channels"], grid=(rows, columns), patch=sizes["image"]["depth_resized"][0] // rows
    )
    condition = {"uncond": None, "text": TextCondition(width=sizes["text"]["width"]), "image": image}[kind]
    same = ["lane_width", "lane_heads", "agent_width", "agent_heads", "mlp_ratio", "blocks", "l2l_stages"]
    return DenoiserConfig(
        **{name: sizes[name] for name in same},
        cross_attention=CrossGlobalOptions(latent_tokens=sizes["latent_tokens"]),
        **{name: limits[name] for name in ("lane_latent", "agent_latent", "max_lanes", "max_agents")},
        domains=sizes["map_ids"],
        crops=sizes["scene_types"],
        condition=condition,
        attend_padding=True,
        cross_adaln_init="xavier",
    )


def scenes(data: dict[str, np.ndarray]) -> int:
    """Number of scenes s0, s1, ... in a file."""
    return len({key.split("/")[0] for key in data if key.startswith("s") and key[1].isdigit()})


def padded(arrays: list[np.ndarray], rows: int | None = None, fill=0) -> jnp.ndarray:
    """[n_k, ...] -> [B, rows, ...]."""
    rows = rows or max(map(len, arrays))
    out = np.full((len(arrays), rows, *arrays[0].shape[1:]), fill, arrays[0].dtype)
    for row, array in zip(out, arrays, strict=True):
        row[: len(array)] = array
    return jax.device_put(out)  # jnp.asarray would compile for every shape


def pair(data: dict[str, np.ndarray], names: list[str], agent: str, lane: str, rows: tuple | None = None) -> PerType:
    """Padded batch of a pair of arrays over the scenes ``names``."""
    agents, lanes = rows or (None, None)
    return PerType(
        agents=padded([data[f"{s}/{agent}"] for s in names], agents),
        lanes=padded([data[f"{s}/{lane}"] for s in names], lanes),
    )


def masks(data: dict[str, np.ndarray], names: list[str], agent: str, lane: str, rows: tuple | None = None) -> PerType:
    """True at the tokens that the scenes have, for the same arguments as ``pair``."""
    ones = {f"{s}/{key}": np.ones(len(data[f"{s}/{key}"]), bool) for s in names for key in (agent, lane)}
    return pair(ones, names, agent, lane, rows)


def features(data: dict[str, np.ndarray], names: list[str], kind: str) -> TextFeatures | ImageFeatures | None:
    """Condition features of the scenes ``names``, or None for kind uncond."""
    if kind == "text":
        tokens = np.stack([data[f"{s}/text"] for s in names])
        return TextFeatures(tokens=jax.device_put(tokens), mask=jax.device_put((tokens != 0).any(-1)))
    if kind == "image":
        dino, depth = (np.stack([data[f"{s}/{key}"] for s in names]) for key in ("dino", "depth"))
        return ImageFeatures(dino=jax.device_put(dino), depth=jax.device_put(depth))
    return None


def labels(config: DenoiserConfig, data: dict[str, np.ndarray], names: list[str]) -> jnp.ndarray:
    """Rows of the label table."""
    return jnp.asarray([config.domains * data[f"{s}/scene_type"] + data[f"{s}/map_id"] for s in names])


def relative(value, reference, what: str = "") -> float:
    """Largest |value - reference| / (1 + |reference|)."""
    value, reference = np.asarray(value, np.float64), np.asarray(reference, np.float64)
    assert value.shape == reference.shape, f"{what}: {value.shape} against {reference.shape}"
    return float((np.abs(value - reference) / (1 + np.abs(reference))).max(initial=0))
