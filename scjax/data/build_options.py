"""Options of a build of records."""

from __future__ import annotations

import dataclasses

from scjax.data.join_options import JOIN_DISTANCE, JoinOptions


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
        if not 0 <= self.split_percent < 100:
            raise ValueError(f"split_percent is {self.split_percent}: it must be at least 0 and below 100")
        if self.files_per_shard < 1:
            raise ValueError(f"files_per_shard is {self.files_per_shard}: it must be at least 1")
        JoinOptions(self.join_distance)
        if self.lane_poses < 0:
            raise ValueError(f"lane_poses is {self.lane_poses}: it must be at least 0")
        for name, poses in (("poses", self.poses), ("train_poses", self.train_poses)):
            for field, value in dataclasses.asdict(poses).items():
                if value <= 0:
                    raise ValueError(f"{name}.{field} is {value}: it must be positive")
