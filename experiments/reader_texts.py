"""Texts that the reader of prompts learns from: composed ones and whole prompts, encoded, each with its request."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from scjax.encoders.text import FrozenTextEncoder, clean_text
from scjax.generate.prompt_reader import token_inputs
from scjax.language.grammar.compose import Composition, compose_freely
from scjax.language.grammar.prompts import retype, written_prompts
from scjax.language.reader.numbers import token_numbers
from scjax.language.reader.targets import Targets, request_targets
from scjax.scene.files import write_file

_PART = 256  # texts that are encoded together
_HELD_BACK_EVERY = 20  # of the prompts, one is not trained on


class Texts(NamedTuple):
    """Encoded texts.

    Attributes:
      features: float16 token features of all texts, one text after the other.
      starts: first token of every text, and the end.
      numbers: number of every token.
      targets, requests: of the texts.
      trained: kind of text -> rows that are trained on; kinds are "composed" and "prompts".
      held_back: kind of text -> rows that are only evaluated.
    """

    features: np.ndarray
    starts: np.ndarray
    numbers: list[np.ndarray]
    targets: list[Targets]
    requests: list[dict[str, Any]]
    trained: dict[str, np.ndarray]
    held_back: dict[str, np.ndarray]

    def inputs(self, row: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Inputs of the network for one text."""
        return token_inputs(self.features[self.starts[row] : self.starts[row + 1]], self.numbers[row])


def reader_texts(
    folder: Path,
    encoder: FrozenTextEncoder,
    *,
    composed: int,
    copies: int,
    held_back: int,
    seed: int,
    stop: Sequence[int],
) -> tuple[Texts, str]:
    """Composes, retypes and encodes texts, and returns them with their hash.

    Args:
      folder: of the features; those that are there are read.
      composed: number of texts of the grammar.
      copies: of every written prompt: the first as it is, the others retyped.
      held_back: composed texts that are not trained on; of the written prompts it is one of twenty.
      seed: of the texts.
      stop: ends the work early where it is not empty.
    """
    rng = np.random.default_rng(seed)
    texts = [compose_freely(rng) for _ in range(composed)]
    prompts = written_prompts()
    held = [row for row in range(len(prompts)) if row % _HELD_BACK_EVERY == 0]
    kept = [row for row in range(len(prompts)) if row % _HELD_BACK_EVERY]
    trained = [prompts[row] for row in kept]
    texts += [*(prompts[row] for row in held), *trained]
    texts += [retype(one, rng) for _ in range(copies - 1) for one in trained]
    ends = np.cumsum([0, held_back, composed - held_back, len(held), copies * len(kept)])
    rows = [np.arange(*pair) for pair in itertools.pairwise(ends)]
    features, numbers, digest = _encode(folder, encoder, texts, stop)
    starts = np.concatenate([[0], np.cumsum([len(one) for one in numbers])])
    requests = [one.request for one in texts]
    return (
        Texts(
            features=features,
            starts=starts,
            numbers=numbers,
            targets=[request_targets(one) for one in requests],
            requests=requests,
            trained={"composed": rows[1], "prompts": rows[3]},
            held_back={"composed": rows[0], "prompts": rows[2]},
        ),
        digest,
    )


def _encode(
    folder: Path, encoder: FrozenTextEncoder, texts: list[Composition], stop: Sequence[int]
) -> tuple[np.ndarray, list[np.ndarray], str]:
    """Features and numbers of the tokens of all texts, and the hash of the texts and the encoder."""
    features, numbers, digest = [], [], hashlib.sha256(encoder.name.encode())
    for start in tqdm(range(0, len(texts), _PART), desc="texts", unit="part"):
        if stop:
            break
        part = [one.text for one in texts[start : start + _PART]]
        name = hashlib.sha256("\n".join([encoder.name, *part]).encode()).hexdigest()
        digest.update(name.encode())
        path = folder / f"{name[:16]}.npy"
        if not path.is_file():
            found = np.concatenate([one.features for one in encoder(part)])
            write_file(path, lambda file, found=found: np.save(file, found.astype(np.float16)))
        features.append(np.load(path))
        numbers += [token_numbers(clean_text(text), encoder.spans(text)) for text in part]
    joined = np.concatenate(features) if features else np.zeros((0, encoder.width), np.float16)
    return joined, numbers, digest.hexdigest()
