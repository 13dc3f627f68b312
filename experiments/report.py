"""Evaluates a trained model: python -m experiments.report --model=runs/denoiser/model --records=data/records --out=r

Measures on the validation split of the records, which training never saw: reconstruction by the autoencoder; samples
at the counts of validation tiles beside real tiles, also in the tables of the field; novelty against the training
tiles; traffic on real lanes beside baselines. Writes report.json, report.md, samples.npz and pictures/ into the output
folder.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from experiments.evaluation import (
    RANDOM_DRAWS,
    Tiles,
    invalid,
    novelty_rows,
    placement_row,
    realism_row,
    reconstruction_row,
)
from experiments.field_rows import control_rows, distribution_rows
from experiments.report_files import ReportFiles, about, markdown
from scjax.condition import Condition
from scjax.data import records
from scjax.data.build import load_manifest
from scjax.data.pipeline import PipelineConfig, validation_scenes
from scjax.devices import use_every_core
from scjax.metrics.placement import random_lane_aligned, vehicle_pool
from scjax.model import Model, load
from scjax.sampling import reconstruct, sample_many
from scjax.scene import Layout, Scene, empty, stack
from scjax.scene_io import save_npz

GROUP = 64  # scenes asked for at a time, so that the bar moves


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.report", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", required=True, type=Path, help="model folder: WORKDIR/model of a training")
    parser.add_argument("--records", required=True, type=Path, help="records from python -m scjax.data build")
    parser.add_argument("--out", required=True, type=Path, help="output folder")
    parser.add_argument("--samples", type=int, default=500, help="samples at true counts (default: 500)")
    parser.add_argument("--drawn", type=int, default=100, help="samples at drawn counts (default: 100)")
    parser.add_argument("--lane-tiles", type=int, default=100, help="real lane graphs to fill (default: 100)")
    parser.add_argument("--seed", type=int, default=0, help="random seed (default: 0)")
    parser.add_argument("--steps", type=int, help="diffusion steps (default: all of training)")
    parser.add_argument("--guidance", type=float, help="guidance weight; 1 is none")
    args = parser.parse_args(arguments)
    use_every_core()
    for name in ("samples", "lane_tiles"):
        if getattr(args, name) < 1:
            parser.error(f"--{name.replace('_', '-')} must be at least 1, not {getattr(args, name)}")
    if args.drawn < 0:
        parser.error(f"--drawn must be at least 0, not {args.drawn}")
    try:
        report = run(args)
    except (ValueError, OSError, ImportError) as error:
        sys.exit(f"experiments.report: {error}")
    print(markdown(report))
    print(f"report: {args.out}/report.md", file=sys.stderr)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """The whole evaluation, top to bottom; every finished section is on disk."""
    # --- inputs
    model = load(args.model)
    domains = load_manifest(args.records)["domains"]
    val, train = (read_tiles(args.records, model, split) for split in ("val", "train"))
    rng = np.random.default_rng(args.seed)
    key = jax.random.key(args.seed)
    args.out.mkdir(parents=True, exist_ok=True)
    sizes = {
        name: {"scenes": len(tiles.scenes), "clusters": len(set(tiles.clusters))}
        for name, tiles in (("validation", val), ("training", train))
    }
    files = ReportFiles(args.out, {"tiles": sizes, **about(vars(args), model)})

    # --- reconstruction
    decoded = by_parts(val.scenes, lambda part, _: reconstruct(model, part), "reconstruction")
    files.section("reconstruction", {"validation": reconstruction_row(val, decoded)})
    picture(args.out, "reconstruction", [val.scenes, decoded], ["real", "decoded"], spread(len(decoded), 12))
    realism = {
        "real validation": realism_row(val, "real validation"),
        "real training": realism_row(train, "real training"),
        "reconstructed validation": realism_row(Tiles(decoded, val.clusters), "reconstructed"),
    }
    files.section("realism", realism)
    if model.denoiser is None:
        return files.report

    # --- samples at the counts of validation tiles, every tile in turn
    order = [int(tile) for tile in rng.permutation(len(val.scenes)) if len(val.scenes[tile].lane_mask)]
    asked = val[[order[i % len(order)] for i in range(args.samples)]]

    def sampled(conditions: list[Condition], stream: int, title: str) -> list[Scene]:
        def draw(part: list[Condition], number: int) -> list[Scene]:
            part_key = jax.random.fold_in(jax.random.fold_in(key, stream), number)
            return sample_many(part_key, part, model=model, steps=args.steps, guidance=args.guidance)

        return by_parts(conditions, draw, title)

    samples = Tiles(sampled([like(s, domains, model) for s in asked.scenes], 0, "samples"), asked.clusters)
    files.lap("samples")
    realism = {"samples at true counts": realism_row(samples, "samples"), **realism}
    files.section("realism", realism)
    if broken := sum(map(invalid, samples.scenes)):
        raise ValueError(
            f"{broken} of {args.samples} samples are no valid scenes (NaN, infinity): {args.model} diverged, train it "
            "again; the report ends here"
        )
    save_npz(stack(samples.scenes), args.out / "samples.npz")
    if args.drawn and model.counts is not None:
        drawn = sampled([Condition()] * args.drawn, 1, "samples at drawn counts")
        # Nothing ties these to a location: each stands for itself.
        realism["samples at drawn counts"] = realism_row(Tiles(drawn, [str(i) for i in range(len(drawn))]), "drawn")
        files.section("realism", realism)
    populations = {"samples": samples, "reconstructed": Tiles(decoded, val.clusters), "real training": train}
    files.section("distributions", distribution_rows(populations, val, train, "strict"))
    files.section("distributions_compat", distribution_rows(populations, val, train, "compat"))
    files.section("control", control_rows(samples, asked, train, rng))
    rows = spread(min(len(order), args.samples), 12)
    picture(args.out, "samples", [asked.scenes, samples.scenes], ["real", "sample"], rows)

    # --- traffic on real lanes
    count = min(args.lane_tiles, len(order), args.samples)
    real = asked[range(count)]
    conditions = [dataclasses.replace(like(s, domains, model), known=lanes_only(s)) for s in real.scenes]
    filled = Tiles(sampled(conditions, 2, "lane-conditioned"), real.clusters)
    vehicles = vehicle_pool(train.scenes)
    again = real[[i for i in range(count) for _ in range(RANDOM_DRAWS)]]
    random = Tiles([random_lane_aligned(rng, scene, vehicles) for scene in again.scenes], again.clusters)
    lane_conditioned = {
        "lane-conditioned": placement_row(real.scenes, filled),
        "random placement": placement_row(again.scenes, random),
        "independent sample": placement_row(real.scenes, samples[range(count)]),
        "real": placement_row(real.scenes, real),
    }
    files.section("lane_conditioned", lane_conditioned)
    columns = [real.scenes, filled.scenes, random.scenes[::RANDOM_DRAWS]]
    picture(args.out, "lane_conditioned", columns, ["real", "on its lanes", "random"], spread(count, 8))

    # --- novelty
    copies = jittered_tiles(args.records, model, rng, min(len(val.scenes), len(train.scenes)))
    populations = {"samples": samples, "real validation": val, "copies": copies}
    files.section("novelty", novelty_rows(populations, train.scenes))
    return files.report


def read_tiles(folder: Path, model: Model, split: str) -> Tiles:
    """Centred tiles of a split with their location clusters."""
    scenes = validation_scenes(folder, model.representation, split=split)
    origin = [records.decode(data) for data in records.source(folder, split)]
    return Tiles(scenes, [f"{record.domain}/{record.cluster}" for record in origin])


def jittered_tiles(folder: Path, model: Model, rng: np.random.Generator, count: int) -> Tiles:
    """Training tiles at random, moved as the pipeline moves them by default."""
    source, jitter = records.source(folder, "train"), PipelineConfig()
    scenes, clusters = [], []
    for index in rng.choice(len(source), count, replace=False):
        record = records.decode(source[int(index)])
        dx, dy = rng.uniform(-1, 1, 2) * jitter.jitter_position
        turn = np.deg2rad(rng.uniform(-1, 1) * jitter.jitter_heading)
        scenes.append(model.representation.select(records.sample_scene(record, Layout.CENTRED, dx, dy, turn)))
        clusters.append(f"{record.domain}/{record.cluster}")
    return Tiles(scenes, clusters)


def like(scene: Scene, domains: Sequence[str], model: Model) -> Condition:
    """A request with the scene's numbers of lanes and agents and its domain, where the model knows that."""
    domain = domains[int(scene.domain)]
    return Condition(
        num_lanes=len(scene.lane_mask),
        num_agents=len(scene.agent_mask),
        domain=domain if domain in model.domains else None,
    )


def lanes_only(scene: Scene) -> Scene:
    """``scene`` without its agents."""
    bare = empty(0, 0)
    return scene.replace(**{f: getattr(bare, f) for f in ("agents", "agent_types", "agent_mask", "agent_known")})


def by_parts(items: list, make, title: str) -> list:
    """``make(part, number)`` over parts of items of like size (few padded shapes a part), results in order."""
    sizes = [_size(item) for item in items]
    order = sorted(range(len(items)), key=lambda i: sizes[i])
    results: list = [None] * len(items)
    pause = 0.5 if sys.stderr.isatty() else 30.0  # seconds between updates
    with tqdm(total=len(items), desc=title, unit="scene", mininterval=pause) as progress:
        for number, start in enumerate(range(0, len(items), GROUP)):
            part = order[start : start + GROUP]
            for i, made in zip(part, make([items[i] for i in part], number), strict=True):
                results[i] = made
            progress.update(len(part))
    return results


def _size(item: Scene | Condition) -> tuple[int, int]:
    if isinstance(item, Condition):
        return item.num_agents or 0, item.num_lanes or 0
    return len(item.agent_mask), len(item.lane_mask)


def spread(count: int, most: int) -> list[int]:
    """At most ``most`` indices spread over ``count``."""
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, most))})


def picture(out: Path, name: str, columns: list[list[Scene]], titles: list[str], rows: list[int]) -> None:
    """Chosen rows of parallel lists side by side, to pictures/NAME.png."""
    from scjax.viz import grid

    (out / "pictures").mkdir(exist_ok=True)
    scenes = [column[row] for row in rows for column in columns]
    width = len(columns) * (1 if len(columns) > 2 else 2)
    grid(scenes, columns=width, titles=titles * len(rows), path=out / "pictures" / f"{name}.png")


if __name__ == "__main__":
    main()
