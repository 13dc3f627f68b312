"""Does traffic that we place on real lanes stand where real traffic stood?

    python -m experiments.studies.placement --scenes tiles:../shared/eval/tiles_real_train.npz --number 200 \\
        --out docs/results/placement

Each scene keeps its lanes and its ego; its other vehicles are placed again, as many as there were. Compared are our
model, which gets the number alone or also what is measured of the agents, random places on the lanes, and the vehicles
of another real scene with the most similar numbers of lanes and vehicles.

A vehicle matches a real one that is nearer than 1, 2 or 3 m and that no other has taken (metrics.md §3). At true
counts precision and recall are the same number, the match rate. Standard errors are of a bootstrap over locations.

Writes OUT.md and OUT.json; no scene of another is kept.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.page import command_line, script_parser, table_lines, write_page
from experiments.studies.prompts import sample_in_calls
from scjax.evaluate.retrieval import Index, retrieve
from scjax.evaluate.sources import SceneSource, open_source
from scjax.generate.place import placement_condition
from scjax.language.attributes.draw import full_request
from scjax.language.attributes.request_text import request_text
from scjax.language.attributes.table import GROUPS, measure_attributes
from scjax.metrics.detection import average_precision, detections
from scjax.metrics.placement import match, random_lane_aligned, vehicle_pool
from scjax.metrics.pooling import Ratios
from scjax.metrics.realism import scene_realism
from scjax.nn.startup import start_jax
from scjax.scene import AgentType, Scene, permute

ABOUT_AGENTS = ("Agents", "Relations to the ego", "Ego", "Events")
"""Groups of attributes that say nothing of roads."""
COLUMNS = {
    "recall_1m": "1 m",
    "recall_2m": "2 m",
    "recall_3m": "3 m",
    "match": "mean",
    "AP": "AP",
    "vehicles_overlapping": "overlap",
    "off_lane": "off lanes",
    "off_heading": "against lanes",
}
OURS: dict[str, tuple[str, dict[str, Any]]] = {
    "ours: number of vehicles": ("number", {}),
    "ours: attributes of the agents": ("attributes", {}),
    "ours: a prompt that says them": ("prompt", {}),
    "ours: number of vehicles, best of 4, repaired": ("number", {"best_of": 4, "repair": True}),
    "ours: a prompt, best of 4, repaired": ("prompt", {"best_of": 4, "repair": True}),
}
"""Row -> what is said of the agents, and options of ``scjax.sample``."""
RANDOM, RETRIEVED = "random on lanes", "another real scene, same numbers"
GAINS = {RANDOM: "over random", RETRIEVED: "over another scene"}
"""Baseline -> title of the column with what a row has more of the mean than it; errors are of the difference."""
_DRAWS = 200  # bootstrap
_NO_OTHERS = {"pedestrians": 0, "cyclists": 0, "static": 0}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.placement", __doc__)
    parser.add_argument("--scenes", required=True, help="real scenes, as tiles:FILE.npz or records:FOLDER#val")
    parser.add_argument("--number", type=int, default=200, metavar="N", help="scenes (default: %(default)s)")
    parser.add_argument("--model", help="model folder (default: the one that ships)")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")
    parser.add_argument("--seed", type=int, default=7, help="(default: %(default)s)")
    args = parser.parse_args(arguments)
    start_jax()
    try:
        model = scjax.load(args.model)
        source = open_source(args.scenes)
        references, clusters = vehicle_scenes(source, args.number, args.seed)
        rows = {
            "real scenes themselves": references,
            RANDOM: on_lanes(references, args.seed),
            RETRIEVED: retrieved(source, references, clusters, args.seed),
        }
        for name, (said, options) in OURS.items():
            conditions = [request_of(scene, model, said) for scene in references]
            rows[name] = sample_in_calls(conditions, name, args.seed, model=model, **options)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.placement: {error}")
    content = {name: measure(references, scenes, clusters, args.seed) for name, scenes in rows.items()}
    for name, columns in content.items():
        for baseline in GAINS:
            if name in OURS:
                columns[baseline] = gain(references, rows[name], rows[baseline], clusters, args.seed)
    numbers = {
        "scenes": len(references),
        "locations": len(set(clusters)),
        "vehicles": sum(len(one.agents) - 1 for one in references),
    }
    write_page(args.out, _page(content, numbers, command_line("placement", arguments)), {**numbers, "rows": content})


def vehicle_scenes(source: SceneSource, number: int, seed: int) -> tuple[list[Scene], list[str]]:
    """At most so many scenes with their vehicles alone, and their locations; as many locations as there are.

    Scenes without an ego that is a vehicle, without another vehicle or without lanes are left out.
    """
    order = np.random.default_rng(seed).permutation(len(source.clusters)).tolist()
    first = list({source.clusters[row]: row for row in reversed(order)}.values())
    others = set(order) - set(first)
    scenes, clusters = [], []
    for row in (*first, *(row for row in order if row in others)):
        if len(scenes) == number:
            break
        (scene,) = source.read([row])
        scene = only_vehicles(scene)
        if len(scene.agents) > 1 and len(scene.lanes):
            scenes.append(scene)
            clusters.append(source.clusters[row])
    if not scenes:
        raise ValueError("there is no scene with lanes, an ego and another vehicle")
    return scenes, clusters


def only_vehicles(scene: Scene) -> Scene:
    """A scene without agents of other classes; without any if its ego is of another class."""
    rows = np.flatnonzero(scene.agent_types == AgentType.VEHICLE)
    return permute(scene, rows if len(rows) and rows[0] == 0 else rows[:0], np.arange(len(scene.lanes)))


def request_of(scene: Scene, model: scjax.Model, said: str = "number") -> scjax.Condition:
    """Placement on the lanes of a scene around its ego, of as many vehicles.

    Args:
      said: "number": nothing else; "attributes": all attributes of its agents; "prompt": a text that says these.
    """
    number: dict[str, Any] = {"vehicles": len(scene.agents) - 1, **_NO_OTHERS}
    names = {item.name for group in ABOUT_AGENTS for item in GROUPS[group]}
    shown = {name: value for name, value in full_request(measure_attributes(scene)).items() if name in names}
    condition = scjax.Condition(attributes=shown if said == "attributes" else number)
    if said == "prompt":
        condition = dataclasses.replace(condition, prompt=request_text(shown))
    return placement_condition(scene, condition, model, num_agents=len(scene.agents), keep_agents=False)


def on_lanes(references: Sequence[Scene], seed: int) -> list[Scene]:
    """Scenes with as many vehicles at random on the same lanes; speeds and sizes are of any of the references."""
    pool = vehicle_pool(references)
    return [random_lane_aligned(np.random.default_rng([seed, k]), one, pool) for k, one in enumerate(references)]


def retrieved(source: SceneSource, references: Sequence[Scene], clusters: Sequence[str], seed: int) -> list[Scene]:
    """For every reference the vehicles of a scene of another location with the nearest numbers, on its own lanes."""
    scenes = [only_vehicles(one) for one in source.read(range(len(source.clusters)))]

    def index(some: Sequence[Scene], places: Sequence[str]) -> Index:
        counts = np.array([(len(one.lanes), len(one.agents) - 1) for one in some])
        return Index(counts, np.array(places, str), [])

    rows = retrieve(
        "count-matched", index(references, clusters), index(scenes, source.clusters), seed=seed, progress=False
    )
    fields = ("agents", "agent_types", "agent_mask", "agent_known")
    return [
        one.replace(**{name: getattr(scenes[row], name) for name in fields})
        for one, row in zip(references, rows, strict=True)
    ]


def measure(
    references: Sequence[Scene], scenes: Sequence[Scene], clusters: Sequence[str], seed: int
) -> dict[str, list[float]]:
    """Column -> value and standard error. The ego counts nowhere; AP scores by the distance to it."""
    ratios = [_ratios(one, other) for one, other in zip(references, scenes, strict=True)]
    found = [detections(one, other) for one, other in zip(references, scenes, strict=True)]
    places = {name: [k for k, one in enumerate(clusters) if one == name] for name in dict.fromkeys(clusters)}
    rng, groups = np.random.default_rng(seed), list(places.values())

    def values(rows: Sequence[int]) -> dict[str, float]:
        sums = {name: np.sum([ratios[k][name] for k in rows], 0) for name in ratios[0]}
        shares = {name: float(part / whole) if whole else float("nan") for name, (part, whole) in sums.items()}
        shares["match"] = float(np.mean([shares[f"recall_{distance}m"] for distance in (1, 2, 3)]))
        shares["AP"] = average_precision([found[k] for k in rows])["nuscenes"]
        return {name: shares[name] for name in COLUMNS}

    mean = values(range(len(scenes)))
    draws = [
        values([k for place in rng.integers(len(groups), size=len(groups)) for k in groups[place]])
        for _ in tqdm(range(_DRAWS), "bootstrap", disable=None)
    ]
    return {
        name: [round(mean[name], 4), round(float(np.nanstd([draw[name] for draw in draws])), 4)] for name in COLUMNS
    }


def gain(
    references: Sequence[Scene],
    scenes: Sequence[Scene],
    others: Sequence[Scene],
    clusters: Sequence[str],
    seed: int,
) -> list[float]:
    """How much higher the mean match rate of scenes is than that of others, and the error of a paired bootstrap."""

    def matched(some: Sequence[Scene]) -> np.ndarray:
        pairs = [_ratios(one, other) for one, other in zip(references, some, strict=True)]
        return np.array([np.mean([pair[f"recall_{distance}m"][0] for distance in (1, 2, 3)]) for pair in pairs])

    more, vehicles = matched(scenes) - matched(others), np.array([len(one.agents) - 1 for one in references])
    rows_of = [np.flatnonzero(np.array(clusters) == name) for name in dict.fromkeys(clusters)]
    rng, draws = np.random.default_rng(seed), []
    for _ in range(_DRAWS):
        rows = np.concatenate([rows_of[place] for place in rng.integers(len(rows_of), size=len(rows_of))])
        draws.append(more[rows].sum() / vehicles[rows].sum())
    return [round(float(more.sum() / vehicles.sum()), 4), round(float(np.std(draws)), 4)]


def _ratios(reference: Scene, scene: Scene) -> Ratios:
    realism = scene_realism(scene, ego=False)
    on_lane, vehicles = realism["vehicles_on_lane"]
    return {
        **{name: value for name, value in match(reference, scene).items() if name.startswith("recall")},
        "vehicles_overlapping": realism["vehicles_overlapping"],
        "off_lane": (vehicles - on_lane, vehicles),
        "off_heading": realism["off_heading"],
    }


def _page(content: Mapping[str, Mapping[str, list[float]]], numbers: Mapping[str, int], command: str) -> str:
    titles = {**COLUMNS, **GAINS}
    rows = [
        [
            name,
            *("{:.1f} ± {:.1f}".format(*(100 * v for v in columns[key])) if key in columns else "" for key in titles),
        ]
        for name, columns in content.items()
    ]
    counted = ", ".join(f"{value} {name}" for name, value in numbers.items())
    lines = ["# Placement: traffic on real lanes", "", f"`{command}`", "", f"{counted}; all numbers in %.", ""]
    return "\n".join([*lines, *table_lines(["vehicles", *titles.values()], rows), ""])


def _percent(value_and_error: Sequence[float]) -> str:
    return "{:.1f} ± {:.1f}".format(*(100 * part for part in value_and_error))


if __name__ == "__main__":
    main()
