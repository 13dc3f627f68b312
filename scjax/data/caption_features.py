"""Token features of the captions of records: encoded once, then only read.

``text-<split>.bin`` holds the features of every different text (float16, text after text). ``text-<split>.npz`` holds
where each text starts, which texts belong to a record, the hash of the captions and the name of the encoder.
"""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from scjax.data.captions import captions_path, read_captions
from scjax.encoders.base import TextEncoder

FORMAT = 1
_BATCH_SIZE = 256  # texts
_SLOT_STEP = 16  # tokens


class TextStore:
    """Token features of the captions of one split.

    Attributes:
      encoder: name of the encoder; width: features of a token.

    Raises:
      ValueError: if there are none, or the captions have been written again since.
    """

    def __init__(self, folder: str | Path, split: str):
        index, data = _paths(Path(folder), split)
        remedy = f"run python -m scjax.data embed {folder}"
        if not index.is_file() or not data.is_file():
            raise ValueError(f"{index} is not there: {remedy}")
        try:
            with index.open("rb") as file, np.load(file) as content:
                arrays = dict(content)
        except (ValueError, OSError, zipfile.BadZipFile) as error:
            raise ValueError(f"{index} is damaged ({error}): {remedy} again") from error
        if int(arrays["format"]) != FORMAT or str(arrays["captions"]) != _digest(Path(folder), split):
            raise ValueError(f"{index} belongs to other captions, or has another format: {remedy} again")
        self.encoder, self.width = str(arrays["encoder"]), int(arrays["width"])
        self._token_starts, self._text_starts, self._texts = arrays["starts"], arrays["first"], arrays["texts"]
        self._longest = int(np.diff(self._token_starts).max(initial=1))
        self._features_path = data
        self._tokens: np.ndarray | None = None

    @property
    def num_texts(self) -> int:
        """Number of different texts."""
        return len(self._token_starts) - 1

    def __len__(self) -> int:
        """Number of records."""
        return len(self._text_starts) - 1

    def slots(self, most: int) -> int:
        """Token slots that hold every text of the store, in steps of 16, but ``most`` at most."""
        return min(-(-self._longest // _SLOT_STEP) * _SLOT_STEP, most)

    def texts_of(self, record: int) -> np.ndarray:
        """Indices of the texts of a record, [texts]."""
        return self._texts[self._text_starts[record] : self._text_starts[record + 1]]

    def features(self, text: int) -> Float[np.ndarray, "tokens width"]:
        """Features of the tokens of one text, float16, read-only."""
        if self._tokens is None:  # opened late, so that a store can be sent to other processes
            self._tokens = np.memmap(self._features_path, np.float16, "r").reshape(-1, self.width)
        return self._tokens[self._token_starts[text] : self._token_starts[text + 1]]

    def __getstate__(self):
        return vars(self) | {"_tokens": None}


def embed_captions(
    folder: str | Path, encoder: TextEncoder, *, splits: Sequence[str] = ("train", "val"), progress: bool = True
) -> dict[str, int]:
    """Encodes the captions of the splits that have any; returns the number of different texts of each.

    A split whose captions and encoder are unchanged is left as it is.

    Raises:
      ValueError: no split has captions.
    """
    folder, counts = Path(folder), {}
    for split in splits:
        if not captions_path(folder, split).is_file():
            continue
        try:
            store = TextStore(folder, split)
            if store.encoder == encoder.name:
                counts[split] = store.num_texts
                continue
        except ValueError:
            pass
        rows: list[list[int]] = []
        index_of: dict[str, int] = {}
        for caption in read_captions(folder, split):
            texts = [text for style in caption.texts.values() for text in style]
            rows.append([index_of.setdefault(text, len(index_of)) for text in texts])
        counts[split] = _write(folder, split, list(index_of), rows, encoder, progress)
    if not counts:
        raise ValueError(f"{folder} holds no captions: run python -m scjax.data caption {folder}")
    return counts


def _write(
    folder: Path, split: str, texts: Sequence[str], rows: list[list[int]], encoder: TextEncoder, progress: bool
) -> int:
    index, data = _paths(folder, split)
    temporary = [path.with_name(f".{path.name}.{os.getpid()}.part") for path in (index, data)]
    lengths = np.zeros(len(texts), np.int64)
    index.unlink(missing_ok=True)  # its presence says that the features are complete
    bar = tqdm(total=len(texts), desc=f"texts of {split}", unit="text", disable=not progress)
    with temporary[1].open("wb") as file, bar:
        for start in range(0, len(texts), _BATCH_SIZE):
            encoded = encoder(texts[start : start + _BATCH_SIZE])
            for row, text in enumerate(encoded):
                lengths[start + row] = len(text.features)
                file.write(text.features.astype(np.float16).tobytes())
            bar.update(len(encoded))
    temporary[1].replace(data)
    with temporary[0].open("wb") as file:
        np.savez(
            file,
            format=FORMAT,
            captions=_digest(folder, split),
            encoder=encoder.name,
            width=encoder.width,
            starts=np.concatenate([[0], np.cumsum(lengths)]),
            first=np.concatenate([[0], np.cumsum([len(row) for row in rows])]).astype(np.int64),
            texts=np.array([text for row in rows for text in row], np.int64),
        )
    temporary[0].replace(index)
    return len(texts)


def _paths(folder: Path, split: str) -> tuple[Path, Path]:
    return folder / f"text-{split}.npz", folder / f"text-{split}.bin"


def _digest(folder: Path, split: str) -> str:
    with captions_path(folder, split).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
