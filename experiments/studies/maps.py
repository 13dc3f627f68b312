"""How well do maps grow? Many routes from the model that ships, each from a scene of its own.

    python -m experiments.studies.maps --maps 50 --length 500 --out docs/results/maps

Every map begins with a sampled scene and goes on "straight" without a prompt. A tile is complete if it has no fault
and no lane ends dead on its ground. The page says how often, how well lanes meet at the seams, how many candidates that
took and how long.

Writes OUT.md and OUT.json.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.gallery import reduce_colors
from experiments.studies.page import command_line, script_parser, table_lines, write_page
from scjax.nn.startup import start_jax
from scjax.outpainting.measures import NEAR_SEAM, measure_map, measure_zones
from scjax.outpainting.outpaint import outpaint_steps
from scjax.scene import Map, route_line
from scjax.scene.files import write_text
from scjax.scene.polyline import cumulative_length

ZONES = ("at seams", "elsewhere")
_KEEP = "folder for maps, pictures and numbers; what is there is not made again (default: %(default)s)"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.maps", __doc__)
    parser.add_argument("--model", help="model folder (default: the one that ships)")
    parser.add_argument("--maps", type=int, default=50, metavar="N", help="(default: %(default)s)")
    parser.add_argument("--length", type=float, default=500.0, help="of each route [m] (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the first map (default: %(default)s)")
    parser.add_argument("--keep", type=Path, default=Path("runs/maps"), metavar="DIR", help=_KEEP)
    parser.add_argument("--show", type=int, metavar="SEED", help="the map whose picture the page shows (default: none)")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")
    args = parser.parse_args(arguments)
    start_jax()
    try:
        model = scjax.load(args.model)
        rows = []
        for seed in tqdm(range(args.seed, args.seed + args.maps), "maps", disable=None):
            row = args.keep / f"{seed}.json"
            if not row.exists():
                start = time.process_time()
                *_, map = outpaint_steps(seed, length=args.length, model=model)
                seconds = time.process_time() - start
                args.keep.mkdir(parents=True, exist_ok=True)
                scjax.save_map(map, args.keep / f"{seed}.npz")
                scjax.viz.plot_map(map, path=args.keep / f"{seed}.png")
                write_text(row, json.dumps({"seconds": round(seconds, 1)}))
            seconds = json.loads(row.read_text())["seconds"]
            rows.append(measured(scjax.load_map(args.keep / f"{seed}.npz"), args.length, seconds))
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.maps: {error}")
    text = page(rows, args.length, command_line("maps", arguments))
    if args.show is not None:
        picture = args.out.with_suffix(".png")
        shutil.copyfile(args.keep / f"{args.show}.png", picture)
        reduce_colors(picture, colors=64)
        text += f"\n![One of the maps]({picture.name})\n"
    columns = {name: [row[name] for row in rows] for name, value in rows[0].items() if not isinstance(value, list)}
    write_page(args.out, text, columns)


def measured(map: Map, length: float, seconds: float) -> dict[str, Any]:
    """What the page needs of one map."""
    measures, zones = measure_map(map), measure_zones(map)
    reached = float(cumulative_length(route_line(map, map.routes[0]))[-1]) if map.routes else 0.0
    return {
        "route": round(reached, 1),
        "whole": reached >= length,
        "missing": measures.missing,
        "seconds": round(seconds, 1),
        "lane_length": round(measures.length, 1),
        "dead_ends": measures.dead_ends,
        "largest_share": round(measures.largest_share, 3),
        "gaps": np.round(measures.gaps, 4).tolist(),
        "turns": np.round(np.rad2deg(measures.turns), 2).tolist(),
        "signaled": measures.signaled,
        "differing": measures.differing,
        "complete": measures.complete,
        "tiles": measures.tiles,
        "attempts": measures.attempts,
        "agents": map.num_agents,
        "overlapping": measures.overlapping,
        **{
            f"{zone} {name}": value
            for zone, one in zip(ZONES, zones, strict=True)
            for name, value in one._asdict().items()
        },
    }


def page(rows: Sequence[dict[str, Any]], length: float, command: str) -> str:
    """The page of the results."""
    total = {name: sum(row[name] for row in rows) for name, value in rows[0].items() if isinstance(value, int | float)}
    gaps, turns = (np.concatenate([np.array(row[name]) for row in rows]) for name in ("gaps", "turns"))
    share = np.mean([row["largest_share"] for row in rows])
    values = {
        f"routes of {length:g} m": f"{total['whole']} of {len(rows)}",
        "length of the route, median [m]": f"{np.median([row['route'] for row in rows]):.0f}",
        "tiles that are complete": f"{total['complete']} of {total['tiles']}",
        "tiles that are missing or taken back": str(total["missing"]),
        "maps all of whose tiles are complete": str(sum(row["complete"] == row["tiles"] for row in rows)),
        "candidates for each tile, mean": f"{total['attempts'] / total['tiles']:.1f}",
        "connections at seams": str(len(gaps)),
        "gaps, largest [m]": f"{gaps.max():.3f}",
        "bends at seams: median, 90 %, largest [degrees]": "{:.1f}, {:.1f}, {:.1f}".format(
            *np.quantile(turns, [0.5, 0.9, 1.0])
        ),
        "bends under 5 degrees": f"{(turns < 5).mean():.1%}",
        "connections between two signals, of which the states differ": f"{total['differing']} of {total['signaled']}",
        "dead ends for each km of lane": f"{total['dead_ends'] / total['lane_length'] * 1000:.2f}",
        "share of the largest connected part, mean": f"{share:.2f}",
        "agents that overlap others": f"{total['overlapping'] / max(total['agents'], 1):.2%}",
    }
    seconds = total["seconds"] / max(total["route"], 1) * 100
    values["CPU time for 100 m of route, compiling included, mean [s]"] = f"{seconds:.0f}"
    table = table_lines(["measure", "value"], [[name, value] for name, value in values.items()])
    rates = {
        "lane ends that are dead": [_rate(total, zone, "dead_ends", "ends", 100) + " %" for zone in ZONES],
        "kinks for each km of lane": [_rate(total, zone, "kinks", "length", 1000) for zone in ZONES],
        "agents that overlap others": [_rate(total, zone, "overlapping", "agents", 100) + " %" for zone in ZONES],
        "vehicles beside the lanes": [_rate(total, zone, "beside", "vehicles", 100) + " %" for zone in ZONES],
    }
    seams = table_lines(
        ["measure", f"within {NEAR_SEAM:g} m of a seam", "elsewhere"], [[name, *pair] for name, pair in rates.items()]
    )
    return "\n".join(["# Maps that grow", "", f"`{command}`", "", *table, "", *seams, "", *_NOTES, ""])


def _rate(total: dict[str, Any], zone: str, part: str, whole: str, factor: int) -> str:
    return f"{total[f'{zone} {part}'] / max(total[f'{zone} {whole}'], 1) * factor:.2f}"


_NOTES = (
    "Connected: lanes that follow each other, or that the model lists as beside each other. Roads that cross without a",
    "connection, such as overpasses, are parts of their own. A lane ends dead where nothing follows it on ground that",
    "tiles cover. A tile is complete if it has no fault and no lane ends dead on its ground. A kink is a change of",
    "direction by more than 25 degrees within a meter. Vehicles are beside the lanes if they are more than 1 m from",
    "every lane of their direction, such as parked ones. A route that leads nowhere goes back, and takes tiles back.",
    "",
    "Completeness, bends and kinks are measured by the rules that choose among candidates.",
    "[A judge](map_tiles.md) that shares no code with them sees more faults. Each map was sampled by one thread",
    "(XLA_FLAGS=--xla_cpu_multi_thread_eigen=false): with more, sums are rounded in another order, and maps differ.",
)


if __name__ == "__main__":
    main()
