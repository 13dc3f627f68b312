"""Reads prompts: a frozen multilingual encoder, the reader's network, and the request that its outputs make."""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np

from scjax.encoders.e5 import E5
from scjax.encoders.text import FrozenTextEncoder, clean_text, load_text_encoder
from scjax.language.reader.numbers import LARGEST, token_numbers
from scjax.language.reader.targets import LEVELS, NAMED, RANGES, VALUES, Reading, read_outputs
from scjax.models.reader import ReaderConfig, ReaderOutputs, reader_network
from scjax.nn.functional import Params, flatten
from scjax.nn.safetensors import array_names, named_arrays, read_arrays, write_arrays
from scjax.scene.document import parse_document
from scjax.scene.files import part_path, remove_stale_parts, replace_folder

ENCODER_LAYERS = 4
"""Layers of the encoder that are used. Recall on people's prompts after equal, short training, one seed: 46 % with four
layers, 41 % with all twelve, 37 % with the word vectors alone."""

MAX_TOKENS = 192
"""Tokens of a prompt that are read; more are left out."""

_INDEX, _CURE = "reader.json", "copy the folder again"
_STEP = 32  # tokens are padded to a multiple of so many


class _Index(msgspec.Struct):
    """The content of reader.json."""

    config: dict[str, int]
    encoder: str
    files: dict[str, str]
    notes: dict[str, Any]


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
    """Writes a reader, in place of what the folder holds.

    Args:
      encoder: name of the encoder whose features it reads.
      notes: how it was trained.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    remove_stale_parts(folder.parent, folder.name)
    temporary = part_path(folder)
    temporary.mkdir()
    try:
        files = write_arrays(array_names(params), temporary, dtype="float16")
        content = {"config": dataclasses.asdict(config), "encoder": encoder, "files": files, "notes": notes}
        (temporary / _INDEX).write_text(json.dumps(content, indent=1, allow_nan=False))
        replace_folder(temporary, folder)
    except OSError as error:
        raise OSError(error.errno, f"the reader cannot be written: {error.strerror}", str(folder)) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


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
    index: _Index = parse_document(path.read_bytes(), _Index, path, _CURE)
    try:
        config = ReaderConfig(**index.config)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}: {_CURE}") from error
    sizes = {name: getattr(config, name) for name in ("width", "blocks", "heads", "kernel")}
    if config != reader_config(config.text_width, **sizes):
        raise ValueError(f"{path} was trained with another table of attributes: train it anew")
    params = named_arrays(read_arrays(folder, index.files))
    expected = flatten(reader_network(config).shapes())
    if jax.tree.map(np.shape, flatten(params)) != jax.tree.map(np.shape, expected):
        raise ValueError(f"{path}: the arrays do not fit the config: {_CURE}")
    encoder = load_text_encoder(E5, layers=ENCODER_LAYERS)
    if encoder.name != index.encoder:
        raise ValueError(f"{path} reads the encoder {index.encoder}, but {encoder.name} is here: install that of scjax")
    return PromptReader(config, jax.tree.map(jnp.asarray, params), encoder)


@functools.lru_cache(maxsize=4)
def _program(config: ReaderConfig) -> Callable[..., ReaderOutputs]:
    return jax.jit(reader_network(config).apply)
