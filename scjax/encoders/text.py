"""Text -> token features: tokenizer, frozen network and weights from one folder, laid out as Hugging Face does."""

from __future__ import annotations

import functools
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scjax.encoders import bert, t5
from scjax.encoders.base import CONFIG_FILE, PublishedNetwork, TextNetworkConfig, TokenFeatures, pure_functions
from scjax.encoders.bert import first_layers
from scjax.encoders.minilm import MINILM
from scjax.encoders.package import EncoderPackage
from scjax.encoders.weights import fit_weights, read_json_object, read_network_state, weights_digest
from scjax.nn.functional import Params

_LENGTH_STEP = 32  # texts are padded to a multiple of so many tokens, so that few programs are compiled
_GROUP = 16  # texts in a call
MAX_CHARACTERS = 100_000
"""Of a text; an encoder reads 512 tokens, some 2,500 characters."""


NETWORKS: dict[str, PublishedNetwork] = {
    "bert": bert.NETWORK,
    "t5": t5.NETWORK,
    "umt5": t5.NETWORK,
}
"""``model_type`` of a ``config.json`` -> the network that reads such folders."""


class FrozenTextEncoder:
    """A network with its weights and its tokenizer.

    ``name`` changes with the weights: a model fits the features of one name only.
    """

    def __init__(self, network: PublishedNetwork, config: TextNetworkConfig, params: Params, tokenizer: Any, name: str):
        self.network, self.config, self.params, self.tokenizer, self.name = network, config, params, tokenizer, name
        self._program = _program(network, config)

    @property
    def width(self) -> int:
        """Features of a token."""
        return self.config.width

    def __call__(self, texts: Sequence[str]) -> list[TokenFeatures]:
        """Token features of every text, the same as if it were alone.

        A text with more tokens than the encoder reads (512) is cut at its end.

        Raises:
          ValueError: a text that is empty or no text, or features that are not finite, as of damaged weights.
        """
        encoded = [self._encode(text) for text in texts]
        results: dict[int, TokenFeatures] = {}
        order = sorted(range(len(encoded)), key=lambda i: len(encoded[i].ids))
        for start in range(0, len(order), _GROUP):
            part = order[start : start + _GROUP]
            length = min(-(-len(encoded[part[-1]].ids) // _LENGTH_STEP) * _LENGTH_STEP, self.config.max_tokens)
            rows = 1 if len(texts) == 1 else _GROUP
            ids, mask = np.zeros((rows, length), np.int32), np.zeros((rows, length), bool)
            for row, i in enumerate(part):
                ids[row, : len(encoded[i].ids)] = encoded[i].ids
                mask[row, : len(encoded[i].ids)] = True
            features = np.asarray(self._program(self.params, jnp.asarray(ids), jnp.asarray(mask)))
            if not np.isfinite(features).all():
                raise ValueError(
                    f"the text encoder {self.name} has features that are not finite: copy its folder again"
                )
            for row, i in enumerate(part):
                results[i] = TokenFeatures(features[row, : len(encoded[i].ids)], tuple(encoded[i].tokens))
        return [results[i] for i in range(len(encoded))]

    def with_layers(self, layers: Mapping[int, Params]) -> FrozenTextEncoder:
        """The same encoder with other weights in its layers, under the same name.

        Raises:
          ValueError: they have other shapes.
        """
        if jax.tree.map(np.shape, layers) != jax.tree.map(np.shape, self.params["layers"]):
            raise ValueError(f"the layers do not fit the text encoder {self.name}: take those of the same network")
        return FrozenTextEncoder(
            self.network, self.config, {**self.params, "layers": layers}, self.tokenizer, self.name
        )

    def spans(self, text: str) -> list[tuple[int, int]]:
        """Start and end of every token in ``clean_text(text)``; a special token is nowhere, from 0 to 0."""
        return list(self._encode(text).offsets)

    def is_cut(self, text: str) -> bool:
        """Whether ``text`` has more tokens than the encoder reads."""
        return bool(self._encode(text).overflowing)

    def _encode(self, text: str) -> Any:
        clean = clean_text(text)
        try:
            encoded = self.tokenizer.encode(clean)
        except Exception as error:  # the library raises nothing more precise
            raise ValueError(
                f"the tokenizer of {self.name} fails ({error}): copy the encoder's folder again"
            ) from error
        if not encoded.ids:
            raise ValueError(f"the tokenizer of {self.name} finds no token in {clean[:50]!r}: use other words")
        return encoded


def load_text_encoder(
    source: str | Path | EncoderPackage | None = None, *, layers: int | None = None, progress: bool = True
) -> FrozenTextEncoder:
    """The encoder in a folder or in a package; by default all-MiniLM-L6-v2.

    Args:
      source: a package, or a folder that holds config.json, tokenizer.json and model.safetensors (or its shards and
        their index). Its model type is one of ``NETWORKS``.
      layers: how many layers of a BERT are used, the first ones; None: all.
      progress: whether a bar shows a download.

    Raises:
      ValueError: names the file at fault and the cure.
    """
    source = MINILM if source is None else source
    folder = source.find(progress=progress) if isinstance(source, EncoderPackage) else Path(source)
    return _load(folder.resolve(), layers)


@functools.lru_cache(maxsize=2)
def _load(folder: Path, layers: int | None) -> FrozenTextEncoder:
    content = read_json_object(folder / CONFIG_FILE)
    model_type = content.get("model_type")
    if not isinstance(model_type, str) or model_type not in NETWORKS:
        *others, last = NETWORKS
        raise ValueError(
            f"{folder / CONFIG_FILE}: model type {model_type!r} is not supported: use {', '.join(others)} or {last}"
        )
    network = NETWORKS[model_type]
    try:
        config = network.read_config(content)
        state = read_network_state(folder, network)
        if layers is not None:
            config, state = first_layers(config, state, layers)
        params = fit_weights(state, network, config)
    except ValueError as error:
        raise ValueError(f"{folder}: {error}") from error
    tokenizer = load_tokenizer(folder / "tokenizer.json", config)
    return FrozenTextEncoder(network, config, params, tokenizer, f"{model_type}-{weights_digest(state)}")


@functools.lru_cache(maxsize=8)
def _program(network: PublishedNetwork, config: TextNetworkConfig) -> Callable[..., Array]:
    return jax.jit(pure_functions(network, config).apply)


def clean_text(text: object) -> str:
    """``text`` in Unicode form NFC, with single spaces between its words.

    Raises:
      ValueError: it is no text, empty, or holds bytes that are no characters.
    """
    if not isinstance(text, str):
        raise ValueError(f"a prompt must be a text, not {type(text).__name__}")
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"the prompt has {len(text)} characters: give a sentence or two, {MAX_CHARACTERS} at most")
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise ValueError("the prompt holds bytes that are no text: write it in UTF-8") from error
    plain = " ".join(unicodedata.normalize("NFC", text).split())
    if not plain:
        raise ValueError("the prompt is empty: say what the scene should show, or leave the prompt out")
    return plain


def load_tokenizer(path: Path, config: TextNetworkConfig) -> Any:
    """The tokenizer of a ``tokenizer.json``, cut at what the network reads, once it has encoded a text.

    Raises:
      ValueError: the file is damaged, or belongs to a network with another vocabulary.
    """
    from tokenizers import Tokenizer  # a tenth of a second, which prompts that ship with the model do not need

    cure = "copy the encoder's folder again"
    try:
        tokenizer = Tokenizer.from_file(str(path))
        tokenizer.no_padding()
        tokenizer.enable_truncation(config.max_tokens)
        last = max(tokenizer.get_vocab().values(), default=0)
        tokenizer.encode("a road, 2 cars")
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # the library raises nothing more precise, and panics of Rust are no Exception
        raise ValueError(f"{path}: cannot be read ({' '.join(str(error).split())[:200]}): {cure}") from error
    if last >= config.vocab_size:
        raise ValueError(f"{path}: has token {last}, the network {config.vocab_size} of them: {cure}")
    return tokenizer
