"""Token features of the captions of records: encoded once, then only read.

``text-<split>.bin`` holds the features of every different text (float16, text after text). ``text-<split>.npz`` holds
where each text starts, which texts belong to a record, the name of the encoder, and the hashes of the captions, of the
features and of itself.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from scjax.data.captions import captions_path, read_captions
from scjax.data.record_folder import locked_records
from scjax.data.shards import stamp_file
from scjax.encoders.base import TextEncoder
from scjax.scene.files import whole_file
from scjax.scene.npz import read_npz

FORMAT = 2
_KINDS = {
    **{"format": "iu", "captions": "U", "encoder": "U", "width": "iu", "starts": "iu", "first": "iu", "texts": "iu"},
    **{"features": "U", "index": "U"},
}
_BATCH_SIZE = 256  # texts
_SLOT_STEP = 16  # tokens
_ROWS = ("starts", "first", "texts")  # first token of each text, first text of each record, texts of records


class TextStore:
    """Token features of the captions of one split.

    Attributes:
      encoder: name of the encoder; width: features of a token.

    Raises:
      ValueError: if there are none, they are damaged, or the captions have been written again since.
    """

    def __init__(self, folder: str | Path, split: str):
        index, data = _paths(Path(folder), split)
        remedy = f"run python -m scjax.data embed {folder}"
        if not index.is_file() or not data.is_file():
            raise ValueError(f"{index if data.is_file() else data} is not there: {remedy}")
        arrays = read_npz(index, _KINDS, f"it is damaged, or older than this version: {remedy} again")
        if arrays["format"].tolist() != FORMAT:
            raise ValueError(f"{index} has another format than {FORMAT}: {remedy} again")
        if arrays["index"].tolist() != _hash_arrays(arrays):
            raise ValueError(f"{index} is damaged (its arrays do not match their hash): {remedy} again")
        if str(arrays["captions"]) != _hash_captions(Path(folder), split, remedy):
            raise ValueError(f"{index} belongs to other captions: {remedy} again")
        self.encoder, self.width = str(arrays["encoder"]), int(arrays["width"])
        self._token_starts, self._text_starts, self._texts = (arrays[k].astype(np.int64) for k in _ROWS)
        self._longest = int(np.diff(self._token_starts).max(initial=1))
        _compare(data, 2 * self.width * int(self._token_starts[-1]), str(arrays["features"]), f"{remedy} again")
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
    folder: str | Path,
    encoder: TextEncoder,
    *,
    splits: Sequence[str] = ("train", "val"),
    progress: bool = True,
    on_unchanged: Callable[[str], object] = lambda split: None,
) -> dict[str, int]:
    """Encodes the captions of the splits that have any; returns the number of different texts of each.

    A split whose captions and encoder are unchanged is left as it is.

    Args:
      on_unchanged: called with the name of every split that is left as it is.

    Raises:
      ValueError: no split has captions, they are damaged, another process uses the folder, or features are not finite.
      OSError: a file cannot be written; names it.
    """
    folder, counts = Path(folder), {}
    splits = [split for split in splits if captions_path(folder, split).is_file()]
    if not splits:
        raise ValueError(f"{folder} holds no captions: run python -m scjax.data caption {folder}")
    with locked_records(folder):
        for split in splits:
            try:
                store = TextStore(folder, split)
                if store.encoder == encoder.name:
                    counts[split] = store.num_texts
                    on_unchanged(split)
                    continue
            except ValueError:
                pass
            rows: list[list[int]] = []
            index_of: dict[str, int] = {}
            for caption in read_captions(folder, split):
                rows.append([index_of.setdefault(text, len(index_of)) for text in caption.texts])
            counts[split] = _write(folder, split, list(index_of), rows, encoder, progress)
    return counts


def _write(
    folder: Path, split: str, texts: Sequence[str], rows: list[list[int]], encoder: TextEncoder, progress: bool
) -> int:
    index, data = _paths(folder, split)
    lengths = np.zeros(len(texts), np.int64)
    bar = tqdm(total=len(texts), desc=f"texts of {split}", unit="text", disable=not progress)
    with whole_file(data) as file, bar:
        for start in range(0, len(texts), _BATCH_SIZE):
            encoded = encoder(texts[start : start + _BATCH_SIZE])
            for row, text in enumerate(encoded):
                lengths[start + row] = len(text.features)
                file.write(_checked(text.features, encoder.name, texts[start + row]).tobytes())
            bar.update(len(encoded))
        index.unlink(missing_ok=True)  # it describes the features that are replaced now
    arrays = {
        "format": FORMAT,
        "captions": _hash_captions(folder, split, "caption the records again"),
        "encoder": encoder.name,
        "width": encoder.width,
        "starts": np.concatenate([[0], np.cumsum(lengths)]),
        "first": np.concatenate([[0], np.cumsum([len(row) for row in rows])]).astype(np.int64),
        "texts": np.array([text for row in rows for text in row], np.int64),
        "features": stamp_file(data).sha256,
    }
    with whole_file(index) as file:
        np.savez(file, **arrays, index=_hash_arrays(arrays))  # pyright: ignore[reportArgumentType]
    return len(texts)


def _checked(features: np.ndarray, encoder: str, text: str) -> np.ndarray:
    with np.errstate(over="ignore"):
        features = features.astype(np.float16)
    if not np.isfinite(features).all():
        raise ValueError(
            f"the text encoder {encoder} gives features of {text[:60]!r} that are NaN or above 65504: its weights are "
            "damaged, or too large for float16: choose another encoder"
        )
    return features


def _hash_arrays(arrays: Mapping[str, Any]) -> str:
    """SHA-256 of all arrays of an index except its own hash: their names, types, shapes and values."""
    digest = hashlib.sha256()
    for name in sorted(arrays.keys() - {"index"}):
        array = np.asarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _compare(data: Path, size: int, sha256: str, cure: str) -> None:
    """Raises a ValueError if ``data`` is not the file of features that the index describes."""
    try:
        actual = data.stat().st_size
        if actual != size:
            raise ValueError(f"{data} has {actual} bytes, not the {size} of its index: {cure}")
        if stamp_file(data).sha256 != sha256:
            raise ValueError(f"{data} holds other bytes than were written: {cure}")
    except OSError as error:
        raise ValueError(f"{data} cannot be read ({error.strerror}): {cure}") from error


def _paths(folder: Path, split: str) -> tuple[Path, Path]:
    return folder / f"text-{split}.npz", folder / f"text-{split}.bin"


def _hash_captions(folder: Path, split: str, remedy: str) -> str:
    path = captions_path(folder, split)
    try:
        return stamp_file(path).sha256
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror}): {remedy}") from error
