"""What one trained autoencoder says of the rows: perceptual Fréchet distance, and control in its latents."""

from __future__ import annotations

import functools
import operator
from collections.abc import Mapping, Sequence

import numpy as np
from tqdm import tqdm

from scjax.data.loader import clip_counts
from scjax.evaluate.population import Population
from scjax.evaluate.sources import BUCKET, Source
from scjax.evaluate.tables import Number, Row, Section, control_frame
from scjax.generate.embed import Embedding, embed
from scjax.generate.model import Model
from scjax.metrics.descriptors import Descriptor
from scjax.metrics.perceptual import Gaussian, gaussian_frechet, latent_descriptor

_PART = 250  # scenes
_SPLITS = 20  # of the floor

NOTE = (
    "By one frozen autoencoder: values of different ones are never compared. Perceptual distance: Frechet distance of "
    "Gaussians fitted to the encoder's last state of every lane, against the real scenes; the floor is that of two "
    "sets of training scenes of other locations. CCS, SPG, CSC as in the table of control, on pooled posterior means "
    "and, for the whole scene, the mean state of its lanes."
)


def latent_section(
    rows: Mapping[str, Population],
    reference: Source,
    bank: Source | None,
    model: Model,
    *,
    seed: int = 0,
    draws: int = 200,
) -> Section:
    """All rows; populations that answer no reference have a perceptual distance only."""
    real = _embedded(model, reference, range(len(reference.clusters)), "real")
    states, descriptor = _gaussian(real), _descriptor(real)
    made = {}
    for name, population in rows.items():
        ours = _embedded(model, population.source, range(len(population)), name)
        numbers = {"perceptual distance": Number(gaussian_frechet(_gaussian(ours), states))}
        clusters = population.clusters(0, len(population))
        if population.references is not None:
            chosen = [int(row) for row in population.rows]
            raw = Descriptor(*(x[chosen] for x in descriptor))
            frame = control_frame(raw, clusters, seed)
            values, bounds = frame(_descriptor(ours)), frame.intervals(_descriptor(ours), clusters, draws=draws)
            numbers |= {key: Number(value, *bounds[key]) for key, value in values.items()}
        made[name] = Row(numbers, len(population), len(set(clusters)))
    floor = {} if bank is None else {"perceptual distance": _floor(model, bank, len(real), seed)}
    return Section("As an autoencoder sees them", NOTE, made, floor)


def _embedded(model: Model, source: Source, rows: Sequence[int], title: str) -> list[Embedding]:
    found: list[Embedding] = []
    for start in tqdm(range(0, len(rows), _PART), f"embedding {title}", unit=f"x{_PART} scenes", mininterval=1.0):
        scenes = source.read(rows[start : start + _PART])
        found += embed(model, [clip_counts(model.codec.select(scene), BUCKET) for scene in scenes])
    return found


def _gaussian(scenes: Sequence[Embedding]) -> Gaussian:
    return functools.reduce(operator.add, (Gaussian.of(one.lane_states) for one in scenes))


def _descriptor(scenes: Sequence[Embedding]) -> Descriptor:
    columns = list(zip(*scenes, strict=True))
    return latent_descriptor(*columns)


def _floor(model: Model, bank: Source, scenes: int, seed: int) -> Number:
    """Two sets of as many scenes of other locations, or of half of the bank each, again and again."""
    names, label = np.unique(np.array(bank.clusters, str), return_inverse=True)
    rng = np.random.default_rng(seed)
    # Locations enough for both sets: the bank may be large.
    order = rng.permutation(len(names))
    reached = np.cumsum(np.bincount(label)[order])
    used = order[: int(np.searchsorted(reached, 2 * scenes)) + 1]
    rows = np.flatnonzero(np.isin(label, used))
    embedded = _embedded(model, bank, rows.tolist(), "the floor")
    gaussians = {place: _gaussian([embedded[k] for k in np.flatnonzero(label[rows] == place)]) for place in used}
    values = []
    for _ in range(_SPLITS if len(used) > 1 else 0):
        mixed = rng.permutation(used)
        half = [functools.reduce(operator.add, (gaussians[p] for p in side)) for side in np.array_split(mixed, 2)]
        values.append(gaussian_frechet(*half))
    if not values:
        return Number(float("nan"))
    return Number(float(np.mean(values)), *(float(x) for x in np.quantile(values, [0.025, 0.975])))
