"""Does a lane turn near every crossing at one height?

    python -m benchmarks.crossings SCENES   # a folder of .npz files, one scene each

The judge of people's prompts looks for forks and merges near a crossing. Lanes that turn without any, because a turn
has a lane of its own from the start, are none for it. Here every way over up to three lanes counts that turns by 38
degrees or more within some distance of the crossing, 26 m as there. Crossings as there: at 30 degrees or more, 10 m
or more inside the window.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64
from tqdm import tqdm

from scjax.language.analysis.crossings import find_crossings
from scjax.language.analysis.lane_lines import LaneLines, lane_lines
from scjax.scene.angles import wrap_to_pi
from scjax.scene.io import load_npz

REACH, BORDER = 26.0, 10.0  # m
HALF_TILE = 32.0  # m
MIN_ANGLE, MIN_TURN = np.deg2rad(30.0), np.deg2rad(38.0)
MOST_LANES = 3  # of a way


def without_turns(
    lines: LaneLines, reach: float
) -> tuple[Float64[np.ndarray, "crossings 2"], Bool[np.ndarray, " crossings"]]:
    """Places of all crossings [m], and at which of them no way turns within ``reach`` [m]."""
    crossings = find_crossings(lines).at_level()
    places = crossings.points[:, :2]
    headings = [
        [lines.headings[lane, np.hypot(*(lines.points[lane, :, :2] - place).T).argmin()] for lane in pair]
        for pair, place in zip(crossings.lanes, places, strict=True)
    ]
    one, other = np.reshape(headings, (-1, 2)).T
    angle = np.abs(wrap_to_pi(one - other))
    is_inside = np.abs(places).max(1, initial=0.0) <= HALF_TILE - BORDER
    places = places[is_inside & (np.minimum(angle, np.pi - angle) >= MIN_ANGLE)]
    return places, np.array([not _has_turn(lines, place, reach) for place in places], bool)


def _has_turn(lines: LaneLines, place: np.ndarray, reach: float) -> bool:
    """Whether a way turns within ``reach`` [m] of a place."""
    near = (np.hypot(*np.moveaxis(lines.points[..., :2] - place, -1, 0)) <= reach) & lines.real
    ways = [(lane,) for lane in np.flatnonzero(near.any(1)).tolist()]
    for _ in range(MOST_LANES):
        if any(_total_turn(lines, near, way) >= MIN_TURN for way in ways):
            return True
        ways = [(*way, lane) for way in ways for lane in lines.next[way[-1]] if near[lane].any() and lane not in way]
    return False


def _total_turn(lines: LaneLines, near: np.ndarray, way: tuple[int, ...]) -> float:
    """Between any two points of a way that are near [rad]."""
    headings = np.unwrap(np.concatenate([lines.headings[lane][near[lane]] for lane in way]))
    return float(np.ptp(headings))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.crossings", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", type=Path, help="folder of .npz files")
    parser.add_argument("--reach", type=float, default=REACH, help="distance of a turn from a crossing [m]")
    args = parser.parse_args(arguments)
    files = sorted(args.scenes.glob("*.npz"))
    if not files:
        sys.exit(f"{args.scenes} has no .npz files: write some with `scjax data scenes`")
    scenes, crossings, without = 0, 0, []
    for file in tqdm(files, "scenes", disable=None):
        places, is_without = without_turns(lane_lines(load_npz(file)), args.reach)
        scenes, crossings = scenes + bool(len(places)), crossings + len(places)
        if is_without.any():
            without.append(f"{file.stem} ({', '.join(f'{x:.1f} {y:.1f}' for x, y in places[is_without][:3])})")
    print(f"{scenes} of {len(files)} scenes have crossings at one height, {crossings} in all.")
    print(f"{len(without)} scenes have one without a turn within {args.reach:g} m: {'; '.join(without) or 'none'}")


if __name__ == "__main__":
    main()
