"""The one type for everything with time: trajectories of objects, states of signals, and the map.

Readers of data sets return it, roll-outs return it, exports take it. ``Scene`` is one step of it, cropped around one
object for a network (``scjax.data.log_crop.crop_log``).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene.checks import check_known, check_range, check_unique
from scjax.scene.limits import MAX_COORDINATE
from scjax.scene.map_lane import MapLane, check_lanes
from scjax.scene.scene import AgentType, Signal

OTHER_OBJECT = -1  # object type that no ``AgentType`` stands for
NO_EGO = -1  # ``ego_index`` of a log without a recording car


@dataclasses.dataclass(frozen=True, kw_only=True)
class LogMetadata:
    """Where a log comes from; every field may be empty.

    Attributes:
      domain: name of the data set or simulator.
      scene_id: name of the scene within the domain.
      location_cluster: scenes with equal (domain, location_cluster) share map geometry.
      variant: original format of the source.
      source_file: file or generator that the log was read from; error messages name it.
      source_sha256: hash of the source's content.
      unknown_words: "field: word" -> how often; words that the reader's tables lack, and that count as unknown.
      notes: what of the source is not in the log -> how often.
    """

    domain: str = ""
    scene_id: str = ""
    location_cluster: str = ""
    variant: str = ""
    source_file: str = ""
    source_sha256: str = ""
    unknown_words: dict[str, int] = dataclasses.field(default_factory=dict)
    notes: dict[str, int] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Log:
    """A driving scene over T steps, N objects and S signals, as NumPy arrays in SI units on the host.

    The frame is the source's own (x, y horizontal, z up, right-handed; headings counter-clockwise from +x). Arrays are
    float64, since coordinates of a map may be tens of kilometers. Values are as recorded: outliers are still in.

    Attributes:
      timestamps: time of every step [s], increasing.
      object_ids: track id of every object.
      object_types: ``AgentType`` of every object, or ``OTHER_OBJECT``.
      valid: whether the object was observed at the step; the other object arrays mean nothing where it is False.
      positions: center of the bounding box [m]; z is NaN where not recorded.
      headings: [rad].
      velocities: [m/s].
      sizes: length, width, height [m], constant over time; NaN where not recorded.
      ego_index: index of the recording or controlled car, ``NO_EGO`` if there is none.
      signal_lane_ids: id of the lane that each signal controls.
      signal_states: ``Signal`` of each signal at every step.
      signal_positions: stop point of each signal [m], NaN where not recorded.
      lanes: the map.
      has_topology: True if the lanes' predecessors and successors are recorded, False if geometry must give them.
      metadata: where the log comes from.
    """

    timestamps: Float64[np.ndarray, " T"]
    object_ids: tuple[str, ...]
    object_types: Int[np.ndarray, " N"]
    valid: Bool[np.ndarray, "N T"]
    positions: Float64[np.ndarray, "N T 3"]
    headings: Float64[np.ndarray, "N T"]
    velocities: Float64[np.ndarray, "N T 2"]
    sizes: Float64[np.ndarray, "N 3"]
    ego_index: int = NO_EGO
    signal_lane_ids: tuple[str, ...]
    signal_states: Int[np.ndarray, "S T"]
    signal_positions: Float64[np.ndarray, "S 3"]
    lanes: tuple[MapLane, ...]
    has_topology: bool
    metadata: LogMetadata = LogMetadata()

    @property
    def num_steps(self) -> int:
        """T, the number of time steps."""
        return len(self.timestamps)

    @property
    def num_objects(self) -> int:
        """N, the number of objects, whether or not they are observed at a step."""
        return len(self.object_ids)

    @property
    def dt(self) -> float:
        """Median time between two steps [s]; NaN for a log of one step."""
        return float(np.median(np.diff(self.timestamps))) if self.num_steps > 1 else float("nan")

    def __getitem__(self, steps) -> Log:
        """Some of the steps, in order: ``log[3:9]``, ``log[::5]``."""
        if not isinstance(steps, slice):
            raise TypeError(f"a log is sliced in time, not indexed by {steps!r}: write log[3:4] for step 3")
        return self.select_steps(np.arange(self.num_steps)[steps])

    def select_steps(self, steps: np.ndarray | list[int]) -> Log:
        """The log at these steps. Objects keep their index, also those that are observed at none of the steps.

        Args:
          steps: increasing indices of steps; negative ones are refused.

        Raises:
          ValueError: if there are none, or they do not increase, or lie outside the log.
        """
        steps = np.asarray(steps, int)
        if not len(steps) or steps[0] < 0 or steps[-1] >= self.num_steps or (np.diff(steps) <= 0).any():
            raise ValueError(
                f"steps {steps.tolist()} of a log of {self.num_steps} steps: give increasing indices from 0 to "
                f"{self.num_steps - 1}, at least one"
            )
        return dataclasses.replace(
            self,
            timestamps=self.timestamps[steps],
            valid=self.valid[:, steps],
            positions=self.positions[:, steps],
            headings=self.headings[:, steps],
            velocities=self.velocities[:, steps],
            signal_states=self.signal_states[:, steps],
        )


def validate_log(log: Log) -> Log:
    """``log`` itself, if every invariant of the type holds.

    Raises:
      ValueError: naming the first field at fault, what is wrong and how to mend it.
    """
    _check_shapes(log)
    if not log.num_steps:
        raise ValueError("timestamps is empty: a log needs at least one step")
    if not np.isfinite(log.timestamps).all() or (np.diff(log.timestamps) <= 0).any():
        raise ValueError("timestamps must be finite and increase from step to step: sort the steps, drop repeated ones")
    _check_objects(log)
    _check_signals(log)
    check_lanes(log.lanes)
    return log


def _check_shapes(log: Log) -> None:
    steps, objects, signals = log.num_steps, log.num_objects, len(log.signal_lane_ids)
    shapes = {
        "timestamps": (steps,),
        "object_types": (objects,),
        "valid": (objects, steps),
        "positions": (objects, steps, 3),
        "headings": (objects, steps),
        "velocities": (objects, steps, 2),
        "sizes": (objects, 3),
        "signal_states": (signals, steps),
        "signal_positions": (signals, 3),
    }
    for name, shape in shapes.items():
        if getattr(log, name).shape != shape:
            raise ValueError(
                f"{name} has shape {getattr(log, name).shape}, but {objects} object_ids, {steps} timestamps and "
                f"{signals} signal_lane_ids call for {shape}"
            )


def _check_objects(log: Log) -> None:
    check_unique("object_ids", log.object_ids)
    check_range("object_types", log.object_types, OTHER_OBJECT, len(AgentType) - 1)
    for name in ("positions", "headings", "velocities"):
        values = getattr(log, name)
        values = values[..., None] if values.ndim == 2 else values
        if name == "positions":
            check_known("positions z", values[log.valid, 2])
            values = values[..., :2]
        wrong = log.valid & ~(np.abs(values) < MAX_COORDINATE).all(-1)
        if wrong.any():
            row, step = (int(i) for i in np.argwhere(wrong)[0])
            raise ValueError(
                f"{name} of object {row} at step {step} is {values[row, step].tolist()}: mark the step as not valid"
            )
    check_known("sizes", log.sizes)
    if not NO_EGO <= log.ego_index < log.num_objects:
        raise ValueError(f"ego_index {log.ego_index} is not an index into the {log.num_objects} objects: correct it")


def _check_signals(log: Log) -> None:
    check_unique("signal_lane_ids", log.signal_lane_ids)
    check_range("signal_states", log.signal_states, 0, len(Signal) - 1)
    check_known("signal_positions", log.signal_positions)
