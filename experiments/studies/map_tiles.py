"""What does an independent judge say of the tiles of maps, beside single scenes?

    python -m experiments.studies.map_tiles --judge JUDGE.py --maps runs/maps --out docs/results/map_tiles

MAPS are those of ``experiments.studies.maps``. More maps of 300 m grow with a prompt for each tile, each of
experiments/prompts/tiles.jsonl in turn. Of every generated tile the window around the middle of its new half is cut: it
shows that half whole, and 16 m beyond the seams on both sides. Single scenes are sampled with and without the prompts,
one each, and repaired, as tiles are.

The judge (JUDGE.py --prompts FILE --scenes FOLDER --out FOLDER) shares no code with scjax. Scenes without a prompt are
judged by one of the prompts in turn: that says how often it holds by chance.

Writes OUT.md and OUT.json.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.obedience import FAULTS, judge_row
from experiments.studies.page import add_sampling_options, command_line, script_parser, table_lines, write_page
from experiments.studies.prompts import sample_in_calls
from scjax.nn.startup import start_jax
from scjax.outpainting.coverage import Coverage
from scjax.scene import TILE_SIZE, AgentType, Map, MapTile, Scene, TileStatus
from scjax.scene.angles import wrap_to_pi
from scjax.scene.files import write_text
from scjax.scene.io import save_npz
from scjax.scene.polyline import spread_points

PROMPTS = Path("experiments/prompts/tiles.jsonl")
_AHEAD = 16.0  # m from a tile's center to the middle of its new half
_EGO_WITHIN = 6.0  # m from a place, where a vehicle is its ego
_LENGTH = 300.0  # m of maps with prompts
_INSIDE = 4.0  # m from the border of a window, from where the judge counts loose ends


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.map_tiles", __doc__)
    parser.add_argument("--judge", type=Path, required=True, help="the program that judges scenes")
    parser.add_argument("--maps", type=Path, required=True, metavar="DIR", help="maps that grew without prompts")
    parser.add_argument(
        "--prompted", type=int, default=16, metavar="N", help="maps with prompts, 0: none (default: %(default)s)"
    )
    parser.add_argument(
        "--singles", type=int, default=90, metavar="N", help="single scenes without prompts (default: %(default)s)"
    )
    add_sampling_options(parser, "runs/map_tiles", "of the first map")
    args = parser.parse_args(arguments)
    lines = [json.loads(line) for line in PROMPTS.read_text(encoding="utf-8").splitlines()]
    start_jax()
    try:
        model = scjax.load(args.model)
        plain = [window for path in sorted(args.maps.glob("*.npz")) for _, window in windows(scjax.load_map(path))]
        if not plain:
            raise ValueError(f"--maps: there are no maps with tiles in {args.maps}: run experiments.studies.maps first")
        without = [scjax.Condition()] * args.singles
        rows = {
            "tiles of maps": [(lines[k % len(lines)], scene) for k, scene in enumerate(plain)],
            "single scenes": _each(lines, sample_in_calls(without, "single scenes", 5, model=model, repair=True)),
            **(_with_prompts(args, lines, model) if args.prompted else {}),
        }
        found = {name: judged(args.judge, args.runs / name.replace(" ", "-"), some) for name, some in rows.items()}
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.map_tiles: {error}")
    write_page(args.out, page(found, lines, command_line("map_tiles", arguments)), found)


def _with_prompts(
    args: Any, lines: Sequence[dict[str, Any]], model: scjax.Model
) -> dict[str, list[tuple[dict[str, Any], Scene]]]:
    """Windows of maps with a prompt for each tile, and as many single scenes with prompts."""
    prompted = [pair for map in prompted_maps(args, lines, model) for pair in windows(map)]
    line_of = {line["prompt"]: line for line in lines}
    conditions = [scjax.Condition(prompt=lines[row % len(lines)]["prompt"]) for row in range(len(prompted))]
    scenes = sample_in_calls(conditions, "with prompts", 6, model=model, repair=True)
    return {
        "tiles of maps with prompts": [(line_of[tile.prompt], scene) for tile, scene in prompted],
        "single scenes with prompts": _each(lines, scenes),
    }


def windows(map: Map) -> Iterator[tuple[MapTile, Scene]]:
    """Generated tiles, and the scenes around the lanes nearest to the middle of their new halves.

    Left out are scenes into which roads reach from the border of the map, where the judge would see loose ends.
    """
    borders = np.array([end.place[:2] for end in Coverage(map).open_ends(map) if end.at_border]).reshape(-1, 2)
    lines = [spread_points(lane.points) for lane in map.lanes]
    headings = [np.arctan2(*np.gradient(line[:, :2], axis=0).T[::-1]) for line in lines if len(line) > 1]
    points = np.concatenate([line for line in lines if len(line) > 1])
    directions = np.concatenate(headings)
    for tile in map.tiles:
        if tile.status not in (TileStatus.COMPLETE, TileStatus.INCOMPLETE):
            continue
        middle = np.array([tile.x + _AHEAD * np.cos(tile.yaw), tile.y + _AHEAD * np.sin(tile.yaw)])
        distance = np.hypot(*(points[:, :2] - middle).T)
        distance[np.abs(wrap_to_pi(directions - tile.yaw)) > np.pi / 3] += 100.0
        nearest = int(distance.argmin())
        x, y = (float(value) for value in points[nearest, :2])
        yaw = float(directions[nearest])
        offset, cos, sin = borders - np.array([x, y]), np.cos(yaw), np.sin(yaw)
        reach = np.abs(offset @ np.array([[cos, -sin], [sin, cos]])).max(-1, initial=0.0)
        if not (reach < TILE_SIZE / 2 - _INSIDE).any():
            yield tile, _window(map, x, y, yaw)


def _window(map: Map, x: float, y: float, yaw: float) -> Scene:
    """The scene at a place: its ego is the vehicle there, or a standing one."""
    distance = np.hypot(*(map.agents[:, :2] - np.array([x, y])).T)
    distance[map.agent_types != AgentType.VEHICLE] = np.inf
    if distance.min(initial=np.inf) < _EGO_WITHIN:
        return scjax.crop_map(map, agent=map.agent_ids[int(distance.argmin())])
    return scjax.crop_map(map, x, y, yaw)


def prompted_maps(args: Any, lines: Sequence[dict[str, Any]], model: scjax.Model) -> Iterator[Map]:
    """Maps with a prompt for each tile; what is there already is not made again."""
    texts = [line["prompt"] for line in lines]
    (args.runs / "maps").mkdir(parents=True, exist_ok=True)
    for seed in tqdm(range(args.seed, args.seed + args.prompted), "maps with prompts", disable=None):
        path = args.runs / "maps" / f"{seed}.npz"
        if not path.exists():
            turn = seed % len(texts)
            start = scjax.sample(seed, scjax.Condition(), model=model, repair=True)[0]
            map = scjax.outpaint(seed, start, (texts[turn:] + texts[:turn]) * 10, length=_LENGTH, model=model)
            scjax.save_map(map, path)
        yield scjax.load_map(path)


def _each(lines: Sequence[dict[str, Any]], scenes: Iterable[Scene]) -> list[tuple[dict[str, Any], Scene]]:
    return [(lines[row % len(lines)], scene) for row, scene in enumerate(scenes)]


def judged(judge: Path, folder: Path, some: Sequence[tuple[dict[str, Any], Scene]]) -> dict[str, Any]:
    """What the judge finds of scenes and their prompts."""
    lines = []
    for row, (line, scene) in enumerate(some):
        name = f"{line['id']}-{row}"
        (folder / name).mkdir(parents=True, exist_ok=True)
        save_npz(scene, folder / name / "scene.npz")
        lines.append(line | {"id": name, "style": line["id"]})
    write_text(folder / "prompts.jsonl", "".join(json.dumps(line) + "\n" for line in lines))
    return judge_row(judge, folder)


def page(found: dict[str, Any], lines: Sequence[dict[str, Any]], command: str) -> str:
    """The page of the results."""

    def share(pair: Sequence[int]) -> str:
        return f"{pair[0]} of {pair[1]} ({100 * pair[0] / max(pair[1], 1):.0f} %)"

    rows = [[line["prompt"], *(share(one["styles"][line["id"]]) for one in found.values())] for line in lines]
    rows.append(["all prompts", *(share(one["prompts"]) for one in found.values())])
    faults = [
        [
            title,
            *(f"{100 * part / max(whole, 1):.1f}" for part, whole in (one["faults"][name] for one in found.values())),
        ]
        for name, title in FAULTS.items()
        if name != "ego_off_lane"
    ]
    return "\n".join(
        [
            "# Tiles of maps, by the judge",
            "",
            f"`{command}`",
            "",
            "Prompts that hold in full:",
            "",
            *table_lines(["prompt", *found], rows),
            "",
            "Scenes with a fault, in %:",
            "",
            *table_lines(["fault", *found], faults),
            "",
            "Windows around the middle of the new half of each generated tile, if they lie on covered",
            "ground; incomplete tiles count. Without prompts each scene is judged by one in turn: so often it holds by",
            "chance.",
            "",
        ]
    )


if __name__ == "__main__":
    main()
