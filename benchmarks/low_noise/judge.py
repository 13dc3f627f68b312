"""Soundness of scenes by the judge of ``SCJAX_SHARED/prompts``, which knows nothing of scjax."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import os
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np

from scjax.scene import Link, Scene

OPEN_GAP = 0.5  # m
_FIELDS = ("agents", "agent_types", "agent_mask", "lanes", "lane_mask", "signals", "links")


@dataclasses.dataclass(frozen=True)
class Soundness:
    """What is measured in scenes; shares in percent.

    Attributes:
      gaps: quantiles 0.5, 0.75, 0.9, 0.95 and mean of the gap of linked ends [m].
      open_links: links with a gap above ``OPEN_GAP``.
      overlaps, loose_ends, against_lane, ego_off_lane: scenes with such a fault.
      kinked_lanes: lanes that turn by more than 25 degrees from a segment to the next.
      bends: quantiles 0.5, 0.9, 0.99 of the change of heading at links [degrees].
    """

    scenes: int
    links: int
    gaps: tuple[float, ...]
    open_links: float
    overlaps: float
    loose_ends: float
    against_lane: float
    ego_off_lane: float
    kinked_lanes: float
    bends: tuple[float, ...]


@functools.cache
def load_judge() -> ModuleType:
    """The judge as a module.

    Raises:
      ValueError: there is none.
    """
    path = Path(os.environ.get("SCJAX_SHARED", "../shared")) / "prompts" / "judge.py"
    spec = importlib.util.spec_from_file_location("scjax_judge", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ValueError(f"{path} is missing: set SCJAX_SHARED to the folder of shared material")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def measure_soundness(scenes: Sequence[Scene]) -> Soundness:
    """Faults of single scenes in meters."""
    judge, rows, gaps, bends = load_judge(), [], [], []
    for scene in scenes:
        judged = judge.Scene({name: np.asarray(getattr(scene, name)) for name in _FIELDS} | {"layout": np.array(0)})
        rows.append(judge.soundness(judged))
        gaps.append(judged.linked_gaps)
        bends.append(_bends(scene))
    gap, bend = np.concatenate(gaps), np.concatenate(bends)

    def share(fault: str) -> float:
        return 100 * float(np.mean([row[fault] > 0 for row in rows]))

    return Soundness(
        scenes=len(rows),
        links=len(gap),
        gaps=(*np.quantile(gap, (0.5, 0.75, 0.9, 0.95)).tolist(), float(gap.mean())),
        open_links=100 * float((gap > OPEN_GAP).mean()),
        overlaps=share("overlaps"),
        loose_ends=share("loose_ends"),
        against_lane=share("against_lane"),
        ego_off_lane=share("ego_off_lane"),
        kinked_lanes=100 * sum(row["kinked_lanes"] for row in rows) / max(sum(row["lanes"] for row in rows), 1),
        bends=tuple(np.quantile(bend, (0.5, 0.9, 0.99)).tolist()),
    )


def _bends(scene: Scene) -> np.ndarray:
    """Absolute change of heading [degrees] from the last segment of a lane to the first of its successor."""
    lanes = np.asarray(scene.lanes)[..., :2]
    before, after = np.argwhere(np.asarray(scene.links) == Link.PREDECESSOR).T
    last, first = lanes[before, -1] - lanes[before, -2], lanes[after, 1] - lanes[after, 0]
    turn = np.arctan2(last[:, 0] * first[:, 1] - last[:, 1] * first[:, 0], (last * first).sum(-1))
    return np.abs(np.degrees(turn))
