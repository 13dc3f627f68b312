"""Reads prompts: a multilingual encoder, the reader's network, and the request that its outputs make."""

from __future__ import annotations

import dataclasses
import functools
import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import msgspec
import numpy as np

from scjax.encoders.e5 import E5
from scjax.encoders.text import FrozenTextEncoder, clean_text, load_text_encoder
from scjax.generate.model import DEFAULT_MODEL
from scjax.language.attributes.table import check_attributes
from scjax.language.reader.comparisons import compared_bounds
from scjax.language.reader.numbers import LARGEST, find_numbers, token_numbers
from scjax.language.reader.targets import LEVELS, NAMED, RANGES, VALUES, Reading, read_outputs
from scjax.models.reader_network import ReaderConfig, ReaderOutputs, reader_network
from scjax.nn.functional import Params, flatten
from scjax.nn.rounding import restore_arrays, round_arrays
from scjax.nn.safetensors import array_names, named_arrays, read_arrays, write_arrays
from scjax.scene.document import parse_document
from scjax.scene.files import whole_folder

ENCODER_LAYERS = 4
"""Layers of the encoder that are used. Recall on people's prompts after equal, short training, one seed: 46 % with four
layers, 41 % with all twelve, 37 % with the word vectors alone."""

MAX_TOKENS = 192
"""Tokens of a prompt that are read; more are left out."""

DEFAULT_READER = DEFAULT_MODEL.with_name("pretrained_reader")
"""Folder of the reader that ships with the package."""

INDEX = "reader.json"
_LAYERS = "encoder_layers"  # in the names of arrays
_CURE = "copy the folder again"
_MOST_KEPT = 1000  # readings that a reader remembers
_STEP = 32  # tokens are padded to a multiple of so many


class _Index(msgspec.Struct):
    """The content of reader.json."""

    config: dict[str, int]
    encoder: str
    files: dict[str, str]
    notes: dict[str, Any]
    readings: dict[str, dict[str, Any]] = {}


@dataclasses.dataclass(frozen=True)
class PromptReader:
    """A trained reader and the encoder that it was trained with.

    Attributes:
      config, params: of the network.
      encoder_name: name of the encoder that gives token features.
      readings: texts that were read already; those that ship need no encoder.
      layers: of the encoder, by number, trained together with the network; None: the encoder's own.
    """

    config: ReaderConfig
    params: Params
    encoder_name: str
    readings: dict[str, Reading] = dataclasses.field(default_factory=dict)
    layers: Mapping[int, Params] | None = None

    def __call__(self, texts: Sequence[str]) -> list[Reading]:
        """What each text asks for, the same as if it were alone.

        Raises:
          ValueError: as ``clean_text``; or the encoder cannot be had, or is another one.
        """
        cleaned = [clean_text(text) for text in texts]
        missing = [text for text in dict.fromkeys(cleaned) if text not in self.readings]
        known = self.readings | (dict(zip(missing, self._read(missing), strict=True)) if missing else {})
        for text in list(self.readings)[max(_MOST_KEPT - len(missing), 0) :]:
            del self.readings[text]  # the latest of earlier calls: the first ones ship
        self.readings.update({text: known[text] for text in missing[:_MOST_KEPT]})
        return [known[text] for text in cleaned]

    @functools.cached_property
    def encoder(self) -> FrozenTextEncoder:
        """The encoder, downloaded once if it is not here.

        Raises:
          ValueError: it cannot be had, or is another one.
        """
        encoder = load_text_encoder(E5, layers=ENCODER_LAYERS)
        if encoder.name != self.encoder_name:
            raise ValueError(
                f"the reader of prompts reads the encoder {self.encoder_name}, but {encoder.name} is here: unset "
                f"{E5.variable}, or give the folder of that one"
            )
        return encoder if self.layers is None else encoder.with_layers(self.layers)

    def outputs(self, text: str) -> ReaderOutputs:
        """The logits for a text, a batch of one."""
        (encoded,) = self.encoder([text])
        if len(encoded.features) > MAX_TOKENS:
            warnings.warn(f"a prompt of {len(text.split())} words is too long: its end is not read", stacklevel=5)
        inputs = token_inputs(encoded.features, token_numbers(text, self.encoder.spans(text)))
        return _program(self.config)(self.params, *inputs)

    def _read(self, texts: Sequence[str]) -> list[Reading]:
        readings = []
        for text in texts:
            outputs, compared = self.outputs(text), list(compared_bounds(text))
            stated = [value for _, _, value in find_numbers(text)]
            readings.append(read_outputs(np.asarray(outputs.named[0]), np.asarray(outputs.ends[0]), stated, compared))
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


def save_reader(reader: PromptReader, folder: Path, notes: dict[str, Any]) -> None:
    """Writes a reader with the readings that it holds, in place of what the folder holds.

    Args:
      notes: how it was trained.
    """
    with whole_folder(folder, "the reader") as temporary:
        content = {
            "config": dataclasses.asdict(reader.config),
            "encoder": reader.encoder_name,
            "files": write_arrays(round_arrays(array_names(_arrays(reader))), temporary, dtype="float16"),
            "notes": notes,
            "readings": {
                text: reading._replace(likely=dict(reading.likely))._asdict()
                for text, reading in reader.readings.items()
            },
        }
        (temporary / INDEX).write_text(json.dumps(content, indent=1, allow_nan=False))


def _arrays(reader: PromptReader) -> Params:
    return reader.params if reader.layers is None else {**reader.params, _LAYERS: reader.layers}


def load_reader(folder: Path | None = None) -> PromptReader:
    """The reader in a folder; None: the one that ships, read once.

    Raises:
      ValueError: a file is missing or damaged, or the table of attributes is another.
    """
    return _default_reader() if folder is None else _load(folder)


@functools.cache
def _default_reader() -> PromptReader:
    return _load(DEFAULT_READER)


def _load(folder: Path) -> PromptReader:
    path = folder / INDEX
    if not path.is_file():
        cure = "train one with python -m experiments.train_reader"
        raise ValueError(f"{folder} is no folder of a reader, for it has no {INDEX}: {cure}")
    index: _Index = parse_document(path.read_bytes(), _Index, path, _CURE)
    try:
        config = ReaderConfig(**index.config)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}: {_CURE}") from error
    sizes = {name: getattr(config, name) for name in ("width", "blocks", "heads", "kernel")}
    if config != reader_config(config.text_width, **sizes):
        raise ValueError(f"{path} was trained with another table of attributes: train it anew")
    params = dict(named_arrays(restore_arrays(read_arrays(folder, index.files))))
    layers = params.pop(_LAYERS, None)
    expected = flatten(reader_network(config).shapes())
    if jax.tree.map(np.shape, flatten(params)) != jax.tree.map(np.shape, expected):
        raise ValueError(f"{path}: the arrays do not fit the config: {_CURE}")
    readings = {text: _reading(content, path) for text, content in index.readings.items()}
    return PromptReader(config, jax.device_put(params), index.encoder, readings, jax.device_put(layers))


def _reading(content: dict[str, Any], path: Path) -> Reading:
    try:
        request, likely = check_attributes(content["request"]), check_attributes(content.get("likely", {}))
        return Reading(request, dict(content["shares"]), likely)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: a reading is damaged ({error}): {_CURE}") from error


@functools.lru_cache(maxsize=4)
def _program(config: ReaderConfig) -> Callable[..., ReaderOutputs]:
    return jax.jit(reader_network(config).apply)
