"""Requests of an ablation: held-out scenes' counts with their own conditions, and with shuffled conditions."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.studies.prompts import draw_prompt
from scjax.data import records
from scjax.data.caption_features import TextStore
from scjax.data.captions import read_captions
from scjax.data.window_images import RaycastImages, StoredImages, WindowImages
from scjax.evaluate.hashing import content_hash, row_text
from scjax.evaluate.sources import LARGEST_COUNTS, RecordScenes
from scjax.generate.conditions import Condition, Stream
from scjax.generate.model import Model
from scjax.language.grammar.compose import Composition
from scjax.metrics.control import derangements
from scjax.scene import Crop, Scene

_SEED = 0  # of captions and shuffles: all runs get the same


@dataclasses.dataclass(frozen=True)
class Requests:
    """One request per held-out scene.

    Attributes:
      references: the scenes.
      clusters: their locations.
      own: counts, domain and condition of each scene.
      shuffled: the same counts and domain with the condition of a scene at another location. A model that reads its
        condition is worse with these; one that does not is equally good.
      requests: what the own prompt asks for; empty for images.
      context: mean number of condition tokens.
      fingerprint: a hash of all of it.
    """

    references: list[Scene]
    clusters: list[str]
    own: list[Condition]
    shuffled: list[Condition]
    requests: list[dict[str, Any]]
    context: float
    fingerprint: str


def make_requests(
    modality: str,
    folder: str,
    samples: int,
    model: Model,
    most: tuple[int, int] = LARGEST_COUNTS,
    features: str = "",
    depth: bool = True,
) -> Requests:
    """Requests for evenly spaced held-out records.

    Args:
      modality: "text" (centered windows with a caption) or "image" (forward windows with pictures).
      folder: the records.
      samples: number of records; those with more elements than ``most`` are skipped.
      model: whose types the scenes have.
      most: (agents, lanes) of the largest training bucket.
      features: of pictures of the records (``scjax data embed-images``); "": ray-cast pictures.
      depth: whether pictures come with depth.

    Raises:
      ValueError: there are no such records or pictures, or most are of one location.
    """
    source, crop = RecordScenes(folder, "val"), Crop.CENTERED if modality == "text" else Crop.FORWARD
    locations, tiles = source.clusters, records.open_records(folder, "val")
    rows = np.unique(np.linspace(0, len(locations) - 1, min(samples, len(locations))).astype(int))
    candidates = [
        model.codec.select(records.sample_scene(records.decode_record(tiles[int(row)]), crop)) for row in rows
    ]
    fits = [scene.num_agents <= most[0] and scene.num_lanes <= most[1] for scene in candidates]
    rows, scenes = rows[fits], list(itertools.compress(candidates, fits))
    if not scenes:
        raise ValueError(f"{folder}: none of {len(fits)} held-out records has at most {most} agents and lanes")
    stated: list[Composition] = []
    encoder = ""
    if modality == "text":
        captions, store = list(read_captions(folder, "val")), TextStore(folder, "val")
        rng = np.random.default_rng(_SEED)
        prompts = [draw_prompt(store, captions[row], int(row), rng) for row in rows]
        stated = [composition for composition, _ in prompts]
        context = float(np.mean([len(tokens) for _, tokens in prompts]))
        streams = [{"text": Stream(tokens)} for _, tokens in prompts]
    else:
        images: WindowImages = StoredImages(features, "val") if features else RaycastImages()
        streams = [_picture_streams(images, scene, int(row), depth) for scene, row in zip(scenes, rows, strict=True)]
        context, encoder = float((1 + depth) * np.prod(images.grid)), images.encoder
    clusters = [locations[row] for row in rows]
    others = derangements(clusters, np.random.default_rng(_SEED), 1)[0]
    counts = [
        {
            "num_lanes": max(int(scene.num_lanes), 1),
            "num_agents": int(scene.num_agents),
            "domain": source.domains[int(scene.domain)],
            "crop": crop,
        }
        for scene in scenes
    ]
    own = [Condition(**count, streams=one) for count, one in zip(counts, streams, strict=True)]
    shuffled = [Condition(**count, streams=streams[row]) for count, row in zip(counts, others, strict=True)]
    fingerprint = content_hash(
        modality, source.fingerprint, row_text(rows), row_text(others), "\n".join(one.text for one in stated), encoder
    )
    return Requests(scenes, clusters, own, shuffled, [one.request for one in stated], context, fingerprint)


def _picture_streams(images: WindowImages, scene: Scene, row: int, depth: bool) -> dict[str, Stream]:
    seen = images(scene, row)
    own = {"image": Stream.from_image(seen.image)}
    return own | {"depth": Stream.from_depth(seen.depth)} if depth else own


def pad_texts(conditions: Sequence[Condition], slots: int) -> list[Condition]:
    """Conditions whose texts have ``slots`` tokens, with masked padding; unchanged with 0."""
    if not slots:
        return list(conditions)
    padded = []
    for condition in conditions:
        real = np.asarray(condition.streams["text"].tokens)[:slots]
        tokens = np.zeros((slots, real.shape[1]), np.float32)
        tokens[: len(real)] = real
        text = Stream(tokens, mask=np.arange(slots) < len(real))
        padded.append(dataclasses.replace(condition, streams={**condition.streams, "text": text}))
    return padded
