"""Features of a folder of pictures: computed once, then only read.

OUT/features holds an entry for each picture and its depth (``encoders.feature_cache``); OUT/images.json lists them and
is written last. An interrupted run continues: entries that are there are not computed again.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from tqdm import tqdm

from scjax.camera.camera import Camera
from scjax.camera.photo import PHOTO_SUFFIXES, Photo, open_photo
from scjax.camera.standard_view import standard_view
from scjax.encoders.depth import DepthProvider, NoDepth
from scjax.encoders.feature_cache import FeatureCache, depth_key, image_key
from scjax.encoders.image_network import GROUP
from scjax.encoders.preprocessing import SQUASH, Preprocessing
from scjax.encoders.vision import GridTokens, ImageEncoder
from scjax.scene.document import parse_document
from scjax.scene.files import locked_folder, write_file

INDEX_FORMAT = 1
_INDEX, _FEATURES = "images.json", "features"


class ImageEntry(msgspec.Struct):
    """A picture: its path in the folder, and the keys of its features and its depth ("" for none)."""

    file: str
    image: str
    depth: str


class SkippedImage(msgspec.Struct):
    """A picture that could not be used, and why."""

    file: str
    reason: str


class ImageIndex(msgspec.Struct, kw_only=True):
    """images.json."""

    format: int
    encoder: str
    width: int
    preprocessing: str
    grid: tuple[int, int]
    images: list[ImageEntry]
    skipped: list[SkippedImage]


class EmbedReport(NamedTuple):
    """Numbers of pictures computed, found, and without depth, and those that could not be used."""

    computed: int
    reused: int
    without_depth: int
    skipped: list[SkippedImage]


def embed_images(
    folder: str | Path,
    out: str | Path,
    encoder: ImageEncoder,
    preprocessing: Preprocessing = SQUASH,
    *,
    depth: DepthProvider | None = None,
    camera: Camera | None = None,
    progress: bool = True,
) -> EmbedReport:
    """Keeps features, and depth, of all pictures of a folder and its folders.

    Pictures that cannot be read, or are of another shape than the camera's, are left out and listed.

    Args:
      camera: that took all pictures, in the frame of the ego: their standard views are encoded. None: they are encoded
        as they are.

    Raises:
      ValueError: no picture is there, none can be used, or another process uses ``out``.
      OSError: a file cannot be written; names it.
    """
    folder, out = Path(folder), Path(out)
    provider = depth or NoDepth()
    files = list_photos(folder, out)
    if not files:
        raise ValueError(f"{folder} holds no pictures ({', '.join(PHOTO_SUFFIXES)}): give a folder of pictures")
    with locked_folder(out):
        cache = FeatureCache(out / _FEATURES)
        entries: list[ImageEntry] = []
        skipped: list[SkippedImage] = []
        reused = 0
        with tqdm(total=len(files), desc="pictures", unit="picture", disable=not progress) as bar:
            for start in range(0, len(files), GROUP):
                group = files[start : start + GROUP]
                photos, found = _usable(folder, group, cache, encoder, provider, preprocessing, camera, skipped)
                cache.image_tokens(encoder, list(photos.values()), preprocessing)
                entries += _entries(photos, encoder, provider, preprocessing)
                reused += found
                bar.update(len(group))
        if not entries:
            raise ValueError(f"{folder}: no picture can be used; the first: {skipped[0].file}: {skipped[0].reason}")
        index = ImageIndex(
            format=INDEX_FORMAT,
            encoder=encoder.name,
            width=encoder.width,
            preprocessing=preprocessing.key,
            grid=(preprocessing.rows, preprocessing.columns),
            images=entries,
            skipped=skipped,
        )
        data = msgspec.json.format(msgspec.json.encode(index), indent=1)
        write_file(out / _INDEX, lambda file: file.write(data))
    return EmbedReport(len(entries) - reused, reused, sum(not entry.depth for entry in entries), skipped)


def list_photos(folder: Path, out: Path | None = None) -> list[str]:
    """Paths in ``folder`` of all pictures, in order; hidden folders and ``out`` are left out.

    Raises:
      ValueError: there is no such folder.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder: give a folder of pictures")
    return sorted(_walk(folder, None if out is None else out.resolve()))


def _walk(folder: Path, out: Path | None) -> Iterator[str]:
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".") and (Path(place, name).resolve() != out)]
        for name in names:
            if not name.startswith(".") and Path(name).suffix.lower() in PHOTO_SUFFIXES:
                yield Path(place, name).relative_to(folder).as_posix()


def _usable(
    folder: Path,
    files: Sequence[str],
    cache: FeatureCache,
    encoder: ImageEncoder,
    provider: DepthProvider,
    preprocessing: Preprocessing,
    camera: Camera | None,
    skipped: list[SkippedImage],
) -> tuple[dict[str, Photo], int]:
    """Photos of the files that can be used, with their depth in the cache, and how many were in it altogether."""
    photos: dict[str, Photo] = {}
    found = 0
    for file in files:
        try:
            photo = open_photo(folder / file)
            if camera is not None:
                camera.check_proportions(*photo.size[::-1])
                photo = standard_view(photo, camera)
            is_known = image_key(encoder, photo, preprocessing) in cache
            if not is_known:
                _ = photo.pixels
            if _has_depth(provider, photo):
                is_known = is_known and depth_key(provider, photo, preprocessing) in cache
                cache.depth_tokens(provider, [photo], preprocessing)
        except ValueError as error:
            skipped.append(SkippedImage(file, str(error)))
            continue
        photos[file] = photo
        found += is_known
    return photos, found


def _has_depth(provider: DepthProvider, photo: Photo) -> bool:
    return provider.key_of(photo) != NoDepth().key_of(photo)


def _entries(
    photos: dict[str, Photo], encoder: ImageEncoder, provider: DepthProvider, preprocessing: Preprocessing
) -> list[ImageEntry]:
    return [
        ImageEntry(
            file,
            image_key(encoder, photo, preprocessing),
            depth_key(provider, photo, preprocessing) if _has_depth(provider, photo) else "",
        )
        for file, photo in photos.items()
    ]


class ImageStore:
    """Features of pictures that ``embed_images`` kept.

    Attributes:
      encoder: name of the encoder; width: features of a token; grid: rows and columns.

    Raises:
      ValueError: there are none, or their list is damaged.
    """

    def __init__(self, folder: str | Path):
        path = Path(folder) / _INDEX
        self._cure = f"run scjax data embed-images again for {folder}"
        try:
            data = path.read_bytes()
        except OSError as error:
            raise ValueError(f"{path}: cannot be read ({error.strerror or error}): {self._cure}") from error
        index: Any = parse_document(data, ImageIndex, path, self._cure)
        if index.format != INDEX_FORMAT:
            raise ValueError(f"{path} has format {index.format}, not {INDEX_FORMAT}: {self._cure}")
        self.encoder, self.width, self.grid = index.encoder, index.width, index.grid
        self._cache = FeatureCache(Path(folder) / _FEATURES)
        self._entries = {entry.file: entry for entry in index.images}

    @property
    def files(self) -> list[str]:
        """Paths of the pictures in their folder."""
        return list(self._entries)

    def image(self, file: str) -> GridTokens:
        """Features of a picture; ValueError if they are missing or damaged."""
        return self._read(file, self._entry(file).image)

    def depth(self, file: str) -> GridTokens | None:
        """Depth of a picture, or None; ValueError if it is damaged."""
        key = self._entry(file).depth
        return self._read(file, key) if key else None

    def _entry(self, file: str) -> ImageEntry:
        if file not in self._entries:
            raise ValueError(f"{file} is none of the {len(self._entries)} pictures: {self._cure}")
        return self._entries[file]

    def _read(self, file: str, key: str) -> GridTokens:
        tokens = self._cache.read(key)
        if tokens is None or tokens.grid != tuple(self.grid):
            raise ValueError(f"{self._cache.path(key)}: the features of {file} are missing or damaged: {self._cure}")
        return tokens
