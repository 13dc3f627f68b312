"""Do scenes show what their picture shows? Held-out rendered pictures, as the paper measures image control.

    python -m experiments.studies.image_control --records runs/records --pictures runs/pictures \\
        --out docs/results/image_control

PICTURES holds SPLIT-ROW.jpg (or .png) of the records: what a dashcam on the ego sees (scjax data dashcam). Compared
are single raw samples with the picture, with or without the true numbers of lanes and agents (the paper gives them),
samples without a picture, the scene of the training picture with the nearest mean features, and the autoencoder's
reconstruction, which is the ceiling.

What counts is what the picture shows: vehicles and lanes ahead that no box hides, nor a building if the files of cells
lie beside the pictures. Vehicles are matched one to one. AP, recall and precision are those of the paper, of all
vehicles in the field of view. Intervals are 95 % of a bootstrap over locations.

Writes OUT.md, OUT.json and OUT.jpg.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.image_control_measures import REGION, VEHICLES, View, agreement_ratios, picture_ratios
from experiments.studies.image_control_page import Rows, page_text, save_examples
from experiments.studies.page import command_line, script_parser, write_page
from experiments.studies.prompts import sample_in_calls
from scjax.camera.photo import Photo, open_photo
from scjax.camera.standard_view import standard_camera
from scjax.data import records
from scjax.data.loader import clip_counts
from scjax.encoders.dashcam_weights import takes_standard_views
from scjax.generate.conditions import Condition, Stream
from scjax.generate.image_streams import image_streams, model_preprocessing
from scjax.generate.picture_networks import default_image_encoder
from scjax.generate.reconstruct import reconstruct
from scjax.metrics.control import ControlFrame
from scjax.metrics.descriptors import describe
from scjax.metrics.detection import average_precision, detections
from scjax.metrics.pooling import intervals, pool, values
from scjax.nn.startup import start_jax
from scjax.scene import Crop, Scene

EXAMPLES = 6
_ENDINGS = (".jpg", ".png")
_PER_CALL = 32  # pictures, so that the bar moves
_DRAWS = 500  # bootstrap


class PictureScene(NamedTuple):
    """A record, its forward window and its picture."""

    scene: Scene
    cluster: str
    photo: Photo
    cells: Path


def main(arguments: Sequence[str] | None = None) -> None:
    args = _parser().parse_args(arguments)
    start_jax()
    try:
        model = scjax.load(args.model)
        shown = picture_scenes(args, model, "val", args.number, args.seed)
        content, examples = run_study(args, model, shown)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.image_control: {error}")
    picture = args.out.with_name(f"{args.out.name}.jpg")
    save_examples(examples, picture)
    write_page(args.out, page_text(content, command_line("image_control", arguments), picture.name), content)


def _parser() -> argparse.ArgumentParser:
    parser = script_parser("experiments.studies.image_control", __doc__)
    parser.add_argument("--records", required=True, help="record folder with the splits train and val")
    parser.add_argument("--pictures", required=True, type=Path, help="folder of pictures of these records")
    parser.add_argument("--model", help="model folder (default: the one that ships)")
    parser.add_argument("--number", type=int, default=150, metavar="N", help="scenes (default: %(default)s)")
    parser.add_argument("--samples", type=int, default=4, metavar="N", help="of a picture (default: %(default)s)")
    parser.add_argument(
        "--candidates", type=int, default=2000, metavar="N", help="training pictures to retrieve from (%(default)s)"
    )
    parser.add_argument("--seed", type=int, default=7, help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")
    return parser


def picture_scenes(
    args: argparse.Namespace, model: scjax.Model, split: str, number: int, seed: int
) -> list[PictureScene]:
    """At most so many scenes of a split at random that have a picture, an ego and lanes.

    Raises:
      ValueError: there are none.
    """
    stored = records.open_records(args.records, split)
    files = sorted(path for path in args.pictures.glob(f"{split}-*") if path.suffix in _ENDINGS)
    rows = {int(path.stem.rpartition("-")[2]): path for path in files if path.stem.rpartition("-")[2].isdecimal()}
    rows = {row: path for row, path in rows.items() if row < len(stored)}
    config = model.denoiser.config
    result: list[PictureScene] = []
    for row in np.random.default_rng(seed).permutation(sorted(rows)).tolist():
        if len(result) == number:
            break
        record = records.read_record(stored, row)
        scene = model.codec.select(records.sample_scene(record, Crop.FORWARD))
        scene = clip_counts(scene, (config.max_agents, config.max_lanes))
        if len(scene.agents) and len(scene.lanes):
            path = rows[row]
            cluster = f"{record.domain}/{record.cluster}"
            result.append(PictureScene(scene, cluster, open_photo(path), path.with_suffix(".npz")))
    if not result:
        raise ValueError(f"{args.pictures}: there are no pictures {split}-ROW.jpg: make them with scjax data dashcam")
    return result


def run_study(
    args: argparse.Namespace, model: scjax.Model, shown: Sequence[PictureScene]
) -> tuple[dict[str, Any], list[tuple[Photo, list[Scene]]]]:
    """The numbers of all rows, and photos with the true scene and two samples."""
    references = [one.scene for one in shown]
    views = [View(one.scene, one.cells) for one in tqdm(shown, "views", disable=None)]
    streams = picture_streams(model, [one.photo for one in shown])
    counts = [{"num_lanes": len(one.lanes), "num_agents": len(one.agents)} for one in references]
    seen = [Condition(streams=one) for one in streams]
    counted = [Condition(streams=one, **numbers) for one, numbers in zip(streams, counts, strict=True)]
    unseen = [Condition(crop=Crop.FORWARD) for _ in references]
    blind = [Condition(crop=Crop.FORWARD, **numbers) for numbers in counts]

    def sample(title: str, conditions: Sequence[Condition], draw: int = 0, by: scjax.Model = model) -> list[Scene]:
        return sample_in_calls(conditions, title, args.seed + draw, model=by)

    draws = [sample(f"picture, draw {k + 1}", seen, k) for k in range(max(args.samples, 2))]
    loose = [dataclasses.replace(condition, hold_seen=False) for condition in seen]
    rows = {
        "picture": draws[0],
        "picture, seen agents not held": sample("picture, seen agents not held", loose),
        "picture, no outline either": sample("picture, no outline", loose, by=dataclasses.replace(model, views=None)),
        "picture, true numbers": sample("picture, true numbers", counted),
        "no picture": sample("no picture", unseen),
        "no picture, true numbers": sample("no picture, true numbers", blind),
        "nearest training picture": nearest_scenes(args, model, shown),
        "autoencoder": reconstruct(model, references),
    }
    frame = _control_frame(shown, args.seed)
    content = {
        "scenes": len(shown),
        "locations": len({one.cluster for one in shown}),
        "vehicles seen": int(sum(view.vehicles.sum() for view in views)),
        "samples of a picture": len(draws),
        "knows of buildings": all(one.cells.is_file() for one in shown),
        "rows": {name: _measured(scenes, shown, views, frame, args.seed) for name, scenes in rows.items()},
        "agreement": _agreement(draws, shown, views, args.seed),
    }
    order = np.argsort([-view.vehicles.sum() for view in views], kind="stable")
    chosen = np.unique(np.linspace(0, len(order) - 1, EXAMPLES).astype(int))
    examples = [(shown[k].photo, [references[k], draws[0][k], draws[1][k]]) for k in order[chosen].tolist()]
    return content, examples


def picture_streams(model: scjax.Model, photos: Sequence[Photo]) -> list[Mapping[str, Stream]]:
    """Streams of pictures as ``Condition(image=...)`` has them, computed once for all rows.

    Pictures of ``scjax data dashcam`` are standard views.
    """
    camera = standard_camera() if takes_standard_views(model.image_encoder) else None
    streams: list[Mapping[str, Stream]] = []
    for start in tqdm(range(0, len(photos), _PER_CALL), "pictures", disable=None):
        some = photos[start : start + _PER_CALL]
        streams += image_streams([Condition(image=photo, camera=camera) for photo in some], model)
    return streams


def nearest_scenes(args: argparse.Namespace, model: scjax.Model, shown: Sequence[PictureScene]) -> list[Scene]:
    """For every picture the scene of the training picture whose mean features are nearest, by cosine."""
    candidates = picture_scenes(args, model, "train", args.candidates, args.seed)
    ours, theirs = (mean_features(model, [one.photo for one in some]) for some in (shown, candidates))
    return [candidates[int(row)].scene for row in (ours @ theirs.T).argmax(1)]


def mean_features(model: scjax.Model, photos: Sequence[Photo]) -> np.ndarray:
    """Mean of each picture's tokens, of length 1 [pictures, width]."""
    encoder, preprocessing = default_image_encoder(model), model_preprocessing(model)
    means = []
    for start in tqdm(range(0, len(photos), _PER_CALL), "features", disable=None):
        for image in encoder(photos[start : start + _PER_CALL], preprocessing):
            means.append(image.tokens[image.mask].mean(0))
    result = np.array(means, np.float64)
    return result / np.maximum(np.linalg.norm(result, axis=1, keepdims=True), 1e-12)


def _control_frame(shown: Sequence[PictureScene], seed: int) -> ControlFrame:
    clusters = [one.cluster for one in shown]
    largest = max(clusters.count(cluster) for cluster in set(clusters))
    shuffles = 10 if 2 * largest <= len(clusters) else 0
    raw = describe([one.scene for one in shown])
    return ControlFrame.of(raw, clusters, np.random.default_rng(seed), shuffles=shuffles)


def _measured(
    scenes: Sequence[Scene],
    shown: Sequence[PictureScene],
    views: Sequence[View],
    frame: ControlFrame,
    seed: int,
) -> Rows:
    """Name -> value, and the ends of its interval where there is one."""
    ratios = [picture_ratios(one.scene, scene, view) for one, scene, view in zip(shown, scenes, views, strict=True)]
    clusters, raw = [one.cluster for one in shown], describe(scenes)
    found = [detections(one.scene, s, types=VEHICLES, region=REGION) for one, s in zip(shown, scenes, strict=True)]
    numbers = values(pool(ratios)) | frame(raw) | {"AP": average_precision(found)["nuscenes"]}
    bounds = intervals(ratios, clusters, draws=_DRAWS, seed=seed) | frame.intervals(raw, clusters, seed=seed)
    return _rows(numbers, bounds)


def _agreement(
    draws: Sequence[Sequence[Scene]], shown: Sequence[PictureScene], views: Sequence[View], seed: int
) -> Rows:
    ratios = [agreement_ratios([some[k] for some in draws], view) for k, view in enumerate(views)]
    clusters = [one.cluster for one in shown]
    return _rows(values(pool(ratios)), intervals(ratios, clusters, draws=_DRAWS, seed=seed))


def _rows(numbers: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]) -> Rows:
    return {name: [round(float(x), 4) for x in (value, *bounds.get(name, ()))] for name, value in numbers.items()}


if __name__ == "__main__":
    main()
