"""Reads prompts: a frozen multilingual encoder, the reader's network, and the request that its outputs make."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from scjax.encoders.e5 import E5
from scjax.encoders.text import FrozenTextEncoder, clean_text, load_text_encoder
from scjax.language.reader.numbers import LARGEST, token_numbers
from scjax.language.reader.targets import LEVELS, NAMED, RANGES, VALUES, Reading, read_outputs
from scjax.models.reader import ReaderConfig, ReaderOutputs, reader_network
from scjax.nn.functional import Params, flatten, unflatten
from scjax.nn.safetensors import read_arrays, write_arrays
from scjax.scene.document import parse_document

ENCODER_LAYERS = 4
"""Layers of the encoder that are used: at equal training the fourth was read better than the twelfth or the words."""

MAX_TOKENS = 192
"""Tokens of a prompt that are read; more are left out."""

_INDEX, _CURE = "reader.json", "copy the folder again"
_STEP = 32  # tokens are padded to a multiple of so many


@dataclasses.dataclass(frozen=True)
class PromptReader:
    """A trained reader and the encoder that it was trained with.

    Attributes:
      config, params: of the network.
      encoder: gives token features.
    """

    config: ReaderConfig
    params: Params
    encoder: FrozenTextEncoder

    def __call__(self, texts: Sequence[str]) -> list[Reading]:
        """What each text asks for, the same as if it were alone.

        Raises:
          ValueError: as ``clean_text``.
        """
        readings = []
        for text, encoded in zip(texts, self.encoder(texts), strict=True):
            inputs = token_inputs(encoded.features, token_numbers(clean_text(text), self.encoder.spans(text)))
            outputs = _program(self.config)(self.params, *inputs)
            readings.append(read_outputs(np.asarray(outputs.named[0]), np.asarray(outputs.ends[0])))
        return readings


def token_inputs(features: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features, numbers and mask of one text as a batch of one, padded to few different lengths."""
    features, numbers = features[:MAX_TOKENS], numbers[:MAX_TOKENS]
    extra = -len(features) % _STEP
    mask = np.arange(len(features) + extra) < len(features)
    return np.pad(features, ((0, extra), (0, 0)))[None], np.pad(numbers, (0, extra))[None], mask[None]


def reader_config(text_width: int, **sizes: int) -> ReaderConfig:
    """The sizes that fit the table of attributes."""
    return ReaderConfig(
        text_width=text_width,
        named=len(NAMED),
        values=VALUES,
        ranges=len(RANGES),
        levels=LEVELS,
        numbers=LARGEST + 2,
        **sizes,
    )


def save_reader(config: ReaderConfig, params: Params, encoder: str, folder: Path, notes: dict[str, Any]) -> None:
    """Writes a reader to a new folder.

    Args:
      encoder: name of the encoder whose features it reads.
      notes: how it was trained.
    """
    folder.mkdir(parents=True)
    arrays = {".".join(map(str, path)): np.asarray(leaf) for path, leaf in flatten(params).items()}
    files = write_arrays(arrays, folder, dtype="float16")
    content = {"config": dataclasses.asdict(config), "encoder": encoder, "files": files, "notes": notes}
    (folder / _INDEX).write_text(json.dumps(content, indent=1))


@functools.lru_cache(maxsize=2)
def load_reader(folder: Path) -> PromptReader:
    """The reader in a folder; its encoder is downloaded once if it is not here.

    Raises:
      ValueError: a file is missing or damaged, the table of attributes is another, or the encoder cannot be had.
    """
    path = folder / _INDEX
    if not path.is_file():
        cure = "train one with python -m experiments.train_reader"
        raise ValueError(f"{folder} is no folder of a reader, for it has no {_INDEX}: {cure}")
    content = parse_document(path.read_bytes(), dict[str, Any], path, _CURE)
    try:
        config = ReaderConfig(**content["config"])
        files, encoder_name = content["files"], content["encoder"]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}: {_CURE}") from error
    if config != reader_config(config.text_width, width=config.width, blocks=config.blocks, heads=config.heads):
        raise ValueError(f"{path} was trained with another table of attributes: train it anew")
    arrays = read_arrays(folder, files)
    params = unflatten(
        {tuple(int(part) if part.isdigit() else part for part in name.split(".")): a for name, a in arrays.items()}
    )
    encoder = load_text_encoder(E5, layers=ENCODER_LAYERS)
    if encoder.name != encoder_name:
        raise ValueError(f"{path} reads the encoder {encoder_name}, but {encoder.name} is here: install that of scjax")
    return PromptReader(config, jax.tree.map(jnp.asarray, params), encoder)


@functools.lru_cache(maxsize=4)
def _program(config: ReaderConfig) -> Callable[..., ReaderOutputs]:
    return jax.jit(reader_network(config).apply)
