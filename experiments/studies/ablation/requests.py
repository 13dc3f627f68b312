"""What every run of one kind is asked: held-back scenes' conditions at their counts, and another scene's instead."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from experiments.studies.prompt_adherence import a_prompt
from scjax.camera.raycast import GRID, render
from scjax.data import records
from scjax.data.caption_features import TextStore
from scjax.data.captions import read_captions
from scjax.evaluate.hashing import content_hash, row_text
from scjax.evaluate.sources import LARGEST_COUNTS, RecordScenes
from scjax.generate.conditions import Condition, Stream
from scjax.generate.model import Model
from scjax.language.prompt_parser import PromptSpec, parse_prompt
from scjax.metrics.control import derangements
from scjax.scene import Crop, Scene

_SEED = 0  # of captions and of the shuffle: all runs are asked the same


@dataclasses.dataclass(frozen=True)
class Requests:
    """One request a held-back scene.

    Attributes:
      references, clusters: the scenes and their locations.
      own: a scene's counts, domain and condition.
      shuffled: the same counts and domain with the condition of a scene of another location: what a model that reads
        its condition must do worse with, and a model that does not, exactly as well.
      asked: what each scene's own prompt asks for; empty for images.
      context: condition tokens in the mean.
      fingerprint: changes with all of it.
    """

    references: list[Scene]
    clusters: list[str]
    own: list[Condition]
    shuffled: list[Condition]
    asked: list[PromptSpec]
    context: float
    fingerprint: str


def requests_of(kind: str, folder: str, samples: int, model: Model, most: tuple[int, int] = LARGEST_COUNTS) -> Requests:
    """Of evenly chosen held-back records.

    Args:
      kind: "text", of centred windows with a caption each, or "image", of forward ones with their stand-ins.
      samples: records looked at; those with more elements than ``most`` are passed over.
      model: whose types the scenes have.
      most: (agents, lanes) that the trainings see at most.

    Raises:
      ValueError: there are no such records, or most are of one location.
    """
    source, crop = RecordScenes(folder, "val"), Crop.CENTERED if kind == "text" else Crop.FORWARD
    places, tiles = source.clusters, records.open_records(folder, "val")
    rows = np.unique(np.linspace(0, len(places) - 1, min(samples, len(places))).astype(int))
    looked_at = [model.codec.select(records.sample_scene(records.decode_record(tiles[int(row)]), crop)) for row in rows]
    fit = [scene.num_agents <= most[0] and scene.num_lanes <= most[1] for scene in looked_at]
    rows, scenes = rows[fit], list(itertools.compress(looked_at, fit))
    if not scenes:
        raise ValueError(f"{folder}: none of {len(fit)} held-back records has at most {most} agents and lanes")
    asked: list[PromptSpec] = []
    told, context = "", 2.0 * GRID[0] * GRID[1]
    if kind == "text":
        captions, store = list(read_captions(folder, "val")), TextStore(folder, "val")
        rng = np.random.default_rng(_SEED)
        prompts = [a_prompt(store, captions[row], int(row), rng) for row in rows]
        asked, told = [parse_prompt(text) for text, _ in prompts], "\n".join(text for text, _ in prompts)
        context = float(np.mean([len(tokens) for _, tokens in prompts]))
        streams = [{"text": Stream(tokens)} for _, tokens in prompts]
    else:
        seen = [render(scene) for scene in scenes]
        streams = [{"image": Stream.from_image(one.image), "depth": Stream.from_depth(one.depth)} for one in seen]
    clusters = [places[row] for row in rows]
    other = derangements(clusters, np.random.default_rng(_SEED), 1)[0]
    domains = [source.domains[int(scene.domain)] for scene in scenes]
    counts = [
        {"num_lanes": max(int(scene.num_lanes), 1), "num_agents": int(scene.num_agents), "domain": domain, "crop": crop}
        for scene, domain in zip(scenes, domains, strict=True)
    ]
    own = [Condition(**count, streams=one) for count, one in zip(counts, streams, strict=True)]
    shuffled = [Condition(**count, streams=streams[row]) for count, row in zip(counts, other, strict=True)]
    fingerprint = content_hash(kind, source.fingerprint, row_text(rows), row_text(other), told)
    return Requests(scenes, clusters, own, shuffled, asked, context, fingerprint)


def padded(conditions: Sequence[Condition], slots: int) -> list[Condition]:
    """Conditions whose texts have so many tokens, those added masked; unchanged with 0."""
    if not slots:
        return list(conditions)
    made = []
    for cond in conditions:
        real = np.asarray(cond.streams["text"].tokens)[:slots]
        tokens = np.zeros((slots, real.shape[1]), np.float32)
        tokens[: len(real)] = real
        text = Stream(tokens, mask=np.arange(slots) < len(real))
        made.append(dataclasses.replace(cond, streams={**cond.streams, "text": text}))
    return made
