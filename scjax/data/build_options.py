"""Options of a build of records."""

from __future__ import annotations

import dataclasses

from scjax.data.join_options import JOIN_DISTANCE, JoinOptions
from scjax.data.ranges import MAX_COUNT, check_number

MIN_SPACING = 0.01  # m between two poses
_PERCENT = "it must be at least 0 and below 100"


@dataclasses.dataclass(frozen=True, kw_only=True)
class PoseOptions:
    """Arguments of ``tiles.find_poses`` [m, steps]."""

    spacing: float = 16.0
    max_poses: int = 8
    recorder_stride: int = 10
    other_stride: int = 30


@dataclasses.dataclass(frozen=True, kw_only=True)
class BuildOptions:
    """What goes into the records.

    Attributes:
      split_percent: share of location clusters held out for validation.
      poses: the standard poses, those of the evaluation set. Validation records use these alone.
      train_poses: denser poses that training records have on top of the standard ones.
      files_per_shard: source files per shard.
      join_distance: gap between lanes that are connected all the same, in sources without topology [m].
      lane_poses: poses along the lanes of a map that has no vehicle; 0 leaves such maps out.

    Raises:
      ValueError: if a value is out of range.
    """

    split_percent: float = 10.0
    poses: PoseOptions = PoseOptions()
    train_poses: PoseOptions = PoseOptions(spacing=4.0, max_poses=40, recorder_stride=5)
    files_per_shard: int = 16
    join_distance: float = JOIN_DISTANCE
    lane_poses: int = 0

    def __post_init__(self):
        check_number("split_percent", self.split_percent, 0, 100, _PERCENT, whole=False)
        if self.split_percent == 100:
            raise ValueError(f"split_percent is {self.split_percent}: {_PERCENT}")
        check_number("files_per_shard", self.files_per_shard, 1, MAX_COUNT)
        JoinOptions(self.join_distance)
        check_number("lane_poses", self.lane_poses, 0, MAX_COUNT)
        for name, option, poses in (("poses", "--", self.poses), ("train_poses", "--train-", self.train_poses)):
            check_number(f"{name}.spacing ({option}spacing)", poses.spacing, MIN_SPACING, MAX_COUNT, whole=False)
            for field in ("max_poses", "recorder_stride", "other_stride"):
                label = f"{name}.{field} ({option}{field.replace('_', '-')})"
                check_number(label, getattr(poses, field), 1, MAX_COUNT)
