"""Metrics in the latent space of one trained autoencoder: perceptual Fréchet distance and control."""

from __future__ import annotations

import functools
import operator
from collections.abc import Mapping, Sequence

import numpy as np
from tqdm import tqdm

from scjax.data.loader import clip_counts
from scjax.evaluate.population import Population
from scjax.evaluate.sources import LARGEST_COUNTS, SceneSource
from scjax.evaluate.tables import Number, Row, Section, control_frame
from scjax.generate.embed import Embedding, embed
from scjax.generate.model import Model
from scjax.metrics.descriptors import Descriptor
from scjax.metrics.perceptual import Gaussian, gaussian_frechet, latent_descriptor

_PART_SIZE = 250  # scenes
_SPLITS = 20  # of the floor

NOTE = (
    "By one frozen autoencoder; never compare values of different autoencoders. Perceptual distance: Frechet distance "
    "between Gaussians fitted to the encoder's last state of every lane, against the real scenes; its floor "
    "compares two "
    "sets of training scenes of other locations. CCS, SPG, CSC as in the table of control, on pooled posterior means "
    "and, for the whole scene, on the mean state of its lanes."
)


def latent_section(
    methods: Mapping[str, Population],
    reference: SceneSource,
    retrieval_set: SceneSource | None,
    model: Model,
    *,
    seed: int = 0,
    draws: int = 200,
) -> Section:
    """All methods; those without references have a perceptual distance only."""
    real = _embed(model, reference, range(len(reference.clusters)), "real")
    real_gaussian, real_descriptor = _gaussian(real), _descriptor(real)
    table_rows = {}
    for name, population in methods.items():
        generated = _embed(model, population.source, range(len(population)), name)
        numbers = {"perceptual distance": Number(gaussian_frechet(_gaussian(generated), real_gaussian))}
        clusters = population.clusters(0, len(population))
        if population.references is not None:
            rows = [int(row) for row in population.rows]
            frame = control_frame(Descriptor(*(x[rows] for x in real_descriptor)), clusters, seed)
            descriptor = _descriptor(generated)
            values, bounds = frame(descriptor), frame.intervals(descriptor, clusters, draws=draws)
            numbers |= {key: Number(value, *bounds[key]) for key, value in values.items()}
        table_rows[name] = Row(numbers, len(population), len(set(clusters)))
    floor = {} if retrieval_set is None else {"perceptual distance": _floor(model, retrieval_set, len(real), seed)}
    return Section("In the latent space of an autoencoder", NOTE, table_rows, floor)


def _embed(model: Model, source: SceneSource, rows: Sequence[int], title: str) -> list[Embedding]:
    embeddings: list[Embedding] = []
    starts = range(0, len(rows), _PART_SIZE)
    for start in tqdm(starts, f"embedding {title}", unit=f"x{_PART_SIZE} scenes", mininterval=1.0):
        scenes = source.read(rows[start : start + _PART_SIZE])
        embeddings += embed(model, [clip_counts(model.codec.select(scene), LARGEST_COUNTS) for scene in scenes])
    return embeddings


def _gaussian(scenes: Sequence[Embedding]) -> Gaussian:
    return functools.reduce(operator.add, (Gaussian.of(one.lane_states) for one in scenes))


def _descriptor(scenes: Sequence[Embedding]) -> Descriptor:
    columns = list(zip(*scenes, strict=True))
    return latent_descriptor(*columns)


def _floor(model: Model, retrieval_set: SceneSource, scenes: int, seed: int) -> Number:
    """Distance between two random halves of the locations, over ``_SPLITS`` splits: mean and central 95 %."""
    names, label = np.unique(np.array(retrieval_set.clusters, str), return_inverse=True)
    rng = np.random.default_rng(seed)
    # Only as many locations as two sets need: the retrieval set may be large.
    order = rng.permutation(len(names))
    cumulative = np.cumsum(np.bincount(label)[order])
    used = order[: int(np.searchsorted(cumulative, 2 * scenes)) + 1]
    rows = np.flatnonzero(np.isin(label, used))
    embeddings = _embed(model, retrieval_set, rows.tolist(), "the floor")
    gaussians = {
        cluster: _gaussian([embeddings[k] for k in np.flatnonzero(label[rows] == cluster)]) for cluster in used
    }
    values = []
    for _ in range(_SPLITS if len(used) > 1 else 0):
        halves = np.array_split(rng.permutation(used), 2)
        sides = [functools.reduce(operator.add, (gaussians[cluster] for cluster in half)) for half in halves]
        values.append(gaussian_frechet(*sides))
    if not values:
        return Number(float("nan"))
    return Number(float(np.mean(values)), *(float(x) for x in np.quantile(values, [0.025, 0.975])))
