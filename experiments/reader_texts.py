"""Texts that the reader of prompts learns from: composed ones and whole prompts, encoded, each with its request."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from experiments.reader_encoder import token_features
from scjax.encoders.text import FrozenTextEncoder, clean_text
from scjax.generate.prompt_reader import MAX_TOKENS
from scjax.language.grammar.compose import Composition, compose_freely
from scjax.language.grammar.prompts import retype, written_prompts
from scjax.language.reader.numbers import token_numbers
from scjax.language.reader.targets import Targets, request_targets
from scjax.scene.files import write_file

LENGTHS = (32, 72)
"""Tokens of the texts of a batch; longer texts are not trained on."""

_STEP = 64  # tokens to a multiple of which texts are padded that are only read
_CACHE = "features.npy"
_HELD_BACK_EVERY = 20  # of the prompts, one is not trained on


class Texts(NamedTuple):
    """Encoded texts.

    Attributes:
      features: float16 token features of all texts, one text after the other.
      starts: first token of every text, and the end.
      numbers: of the tokens of every text.
      targets, requests: of the texts.
      trained: kind of text -> rows that are trained on, in one array for each of ``LENGTHS``; kinds are "composed" and
        "prompts".
      held_back: kind of text -> rows that are only evaluated.
    """

    features: np.ndarray
    starts: np.ndarray
    numbers: list[np.ndarray]
    targets: list[Targets]
    requests: list[dict[str, Any]]
    trained: dict[str, list[np.ndarray]]
    held_back: dict[str, np.ndarray]

    def inputs(self, rows: Sequence[int], length: int | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Features, numbers and mask of texts, padded to ``length`` tokens, or to a multiple of a fixed number."""
        lengths = np.array([len(self.numbers[row]) for row in rows])
        length = length or -(-int(lengths.max()) // _STEP) * _STEP
        features = np.zeros((len(rows), length, self.features.shape[1]), np.float16)
        numbers = np.zeros((len(rows), length), np.int32)
        for place, row in enumerate(rows):
            features[place, : lengths[place]] = self.features[self.starts[row] : self.starts[row + 1]]
            numbers[place, : lengths[place]] = self.numbers[row]
        return features, numbers, np.arange(length)[None] < lengths[:, None]


def reader_texts(
    folder: Path, encoder: FrozenTextEncoder, *, composed: int, copies: int, held_back: int, seed: int
) -> tuple[Texts, str]:
    """Composes, retypes and encodes texts, and returns them with their hash.

    Args:
      folder: keeps the features.
      composed: number of texts of the grammar.
      copies: of every written prompt: the first as it is, the others retyped.
      held_back: composed texts that are not trained on; of the written prompts it is one of twenty.
      seed: of the texts.
    """
    rng = np.random.default_rng(seed)
    texts = [compose_freely(rng) for _ in tqdm(range(composed), "texts")]
    prompts = written_prompts()
    held = [row for row in range(len(prompts)) if row % _HELD_BACK_EVERY == 0]
    kept = [row for row in range(len(prompts)) if row % _HELD_BACK_EVERY]
    trained = [prompts[row] for row in kept]
    texts += [*(prompts[row] for row in held), *trained]
    texts += [retype(one, rng) for _ in range(copies - 1) for one in trained]
    ends = np.cumsum([0, held_back, composed - held_back, len(held), copies * len(kept)])
    rows = [np.arange(*pair) for pair in itertools.pairwise(ends)]
    ids, numbers = zip(*(_tokens(encoder, one) for one in texts), strict=True)
    lengths = np.array([len(one) for one in ids])
    starts = np.concatenate([[0], np.cumsum(lengths)])
    digest = hashlib.sha256("\n".join([encoder.name, *(one.text for one in texts)]).encode()).hexdigest()
    return (
        Texts(
            features=_features(folder / digest[:16] / _CACHE, encoder, ids, starts),
            starts=starts,
            numbers=list(numbers),
            targets=[request_targets(one.request) for one in texts],
            requests=[one.request for one in texts],
            trained={"composed": _by_length(rows[1], lengths), "prompts": _by_length(rows[3], lengths)},
            held_back={"composed": rows[0], "prompts": rows[2]},
        ),
        digest,
    )


def _tokens(encoder: FrozenTextEncoder, text: Composition) -> tuple[np.ndarray, np.ndarray]:
    clean = clean_text(text.text)
    encoded = encoder.tokenizer.encode(clean)
    return np.array(encoded.ids[:MAX_TOKENS], np.int32), token_numbers(clean, encoded.offsets[:MAX_TOKENS])


def _features(path: Path, encoder: FrozenTextEncoder, ids: Sequence[np.ndarray], starts: np.ndarray) -> np.ndarray:
    """Of the tokens of all texts; read if they are there."""
    if not path.is_file():
        features = np.zeros((starts[-1], encoder.width), np.float16)
        for row, found in tqdm(token_features(encoder, ids), "encoded", len(ids), mininterval=5.0):
            features[starts[row] : starts[row + 1]] = found
        write_file(path, lambda file: np.save(file, features))
    return np.load(path)


def _by_length(rows: np.ndarray, lengths: np.ndarray) -> list[np.ndarray]:
    return [rows[(lengths[rows] > low) & (lengths[rows] <= high)] for low, high in itertools.pairwise((0, *LENGTHS))]
