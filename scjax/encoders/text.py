"""Text -> token features: tokenizer, frozen network and weights from one folder, laid out as Hugging Face does."""

from __future__ import annotations

import functools
import hashlib
import json
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
import safetensors
import safetensors.numpy
from jaxtyping import Float
from tokenizers import Tokenizer

from scjax.encoders import bert, t5
from scjax.encoders.download import find_encoder
from scjax.nn.functional import Params, functional
from scjax.nn.state_dict import convert

_STEP = 32  # tokens are padded to a multiple of this, so that few programs are compiled
_GROUP = 16  # texts a call


class Tokens(NamedTuple):
    """Features of one text's tokens; special tokens are among them, padding is not."""

    features: Float[np.ndarray, "tokens width"]
    texts: tuple[str, ...]


@runtime_checkable
class Encoder(Protocol):
    """Whatever turns texts into token features; ``name`` tells apart encoders whose features differ."""

    name: str

    @property
    def width(self) -> int: ...

    def __call__(self, texts: Sequence[str]) -> list[Tokens]: ...

    def is_cut(self, text: str) -> bool: ...


class TextEncoder:
    """A frozen encoder. ``name`` changes with the weights: a model fits the features of one name only."""

    def __init__(self, config: bert.BertConfig | t5.T5Config, params: Params, tokenizer: Tokenizer, name: str):
        self.config, self.params, self.tokenizer, self.name = config, params, tokenizer, name
        tokenizer.no_padding()
        tokenizer.enable_truncation(config.longest)

    @property
    def width(self) -> int:
        """Features of a token."""
        return self.config.width

    def __call__(self, texts: Sequence[str]) -> list[Tokens]:
        """Features of every text, each as if it were alone.

        A text with more tokens than the encoder reads (512) is cut at its end.

        Raises:
          ValueError: a text that is empty or no text.
        """
        encoded = [self.tokenizer.encode(checked(text)) for text in texts]
        found: dict[int, Tokens] = {}
        order = sorted(range(len(encoded)), key=lambda i: len(encoded[i].ids))
        for start in range(0, len(order), _GROUP):
            part = order[start : start + _GROUP]
            length = min(-(-len(encoded[part[-1]].ids) // _STEP) * _STEP, self.config.longest)
            rows = 1 if len(texts) == 1 else _GROUP
            ids, mask = np.zeros((rows, length), np.int32), np.zeros((rows, length), bool)
            for row, i in enumerate(part):
                ids[row, : len(encoded[i].ids)] = encoded[i].ids
                mask[row, : len(encoded[i].ids)] = True
            features = np.asarray(_program(self.config)(self.params, jnp.asarray(ids), jnp.asarray(mask)))
            for row, i in enumerate(part):
                found[i] = Tokens(features[row, : len(encoded[i].ids)], tuple(encoded[i].tokens))
        return [found[i] for i in range(len(encoded))]

    def is_cut(self, text: str) -> bool:
        """Whether ``text`` has more tokens than the encoder reads."""
        return bool(self.tokenizer.encode(checked(text)).overflowing)


def load_text_encoder(folder: str | Path | None = None, *, progress: bool = True) -> TextEncoder:
    """The encoder in ``folder``, or all-MiniLM-L6-v2 from where it can be had (see ``find.find_encoder``).

    Args:
      folder: holds config.json, tokenizer.json and model.safetensors (or its shards and their index); model types
        "bert", "t5" and "umt5".

    Raises:
      ValueError: that names the file at fault and the cure.
    """
    place = Path(folder) if folder is not None else find_encoder(progress=progress)
    return _load(place.resolve())


@functools.lru_cache(maxsize=2)
def _load(folder: Path) -> TextEncoder:
    content = read_json(folder / "config.json")
    kind = content.get("model_type")
    if kind not in ("bert", "t5", "umt5"):
        raise ValueError(f"{folder}/config.json: model type {kind!r} is not supported: use bert, t5 or umt5")
    state = read_weights(folder)
    try:
        if kind == "bert":
            config = bert.BertConfig.from_json(content)
            rules, ignored, aliases = bert.rules(config), list(bert.UNUSED), {}
            state = {name.removeprefix("bert."): value for name, value in state.items()}
        else:
            config = t5.T5Config.from_json(content)
            rules, aliases = t5.rules(config), t5.ALIASES
            ignored = [name for name in state if name.startswith(("decoder.", "lm_head."))]
        expected = jax.eval_shape(_network(config).init, jax.random.key(0))
        params = convert(state, rules, expected, ignored, aliases)
    except ValueError as error:
        raise ValueError(f"{folder}: {error}") from error
    path = folder / "tokenizer.json"
    try:
        tokenizer = Tokenizer.from_file(str(path))
    except Exception as error:  # the library raises nothing more precise
        raise ValueError(f"{path}: cannot be read ({error}): copy the encoder's folder again") from error
    return TextEncoder(config, params, tokenizer, f"{kind}-{digest(state)}")


@functools.lru_cache(maxsize=8)
def _network(config: bert.BertConfig | t5.T5Config):
    make = bert.Bert if isinstance(config, bert.BertConfig) else t5.T5
    return functional(lambda init: make(config, init=init))  # type: ignore[arg-type]


@functools.lru_cache(maxsize=8)
def _program(config: bert.BertConfig | t5.T5Config):
    return jax.jit(_network(config).apply)


def checked(text: object) -> str:
    """``text`` with its white space made plain.

    Raises:
      ValueError: if it is no text, empty, or not made of characters.
    """
    if not isinstance(text, str):
        raise ValueError(f"a prompt must be a text, not {type(text).__name__}")
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise ValueError("the prompt holds bytes that are no text: write it in UTF-8") from error
    plain = " ".join(unicodedata.normalize("NFC", text).split())
    if not plain:
        raise ValueError("the prompt is empty: say what the scene should show, or leave the prompt out")
    return plain


def read_json(path: Path) -> dict[str, Any]:
    """An object of a JSON file; ValueError naming the file where that fails."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: cannot be read ({error}): give the folder of a text encoder") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path}: holds no JSON object: give the folder of a text encoder")
    return content


def read_weights(folder: Path) -> dict[str, np.ndarray]:
    """Arrays of model.safetensors, or of all the files that model.safetensors.index.json names."""
    files = [folder / "model.safetensors"]
    if (index := folder / "model.safetensors.index.json").is_file():
        files = [folder / name for name in sorted(set(read_json(index)["weight_map"].values()))]
    state: dict[str, np.ndarray] = {}
    for file in files:
        try:
            state |= safetensors.numpy.load_file(file)
        except (OSError, safetensors.SafetensorError) as error:
            raise ValueError(f"{file}: cannot be read ({error}): copy the encoder's folder again") from error
    return state


def digest(state: dict[str, np.ndarray]) -> str:
    """A short hash of some of the weights: enough to tell encoders apart, and fast for billions of them."""
    total = hashlib.sha256()
    for name in sorted(state):
        flat = state[name].reshape(-1)
        total.update(f"{name}{state[name].shape}".encode())
        total.update(np.ascontiguousarray(flat[:: max(1, flat.size // 64)]).tobytes())
    return total.hexdigest()[:12]
