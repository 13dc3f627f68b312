"""Animations of logs: a bird's-eye view that follows one object, as frames, GIF or MP4."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Int, UInt8

from scjax.scene import NO_EGO, Log, validate_log
from scjax.viz.bev import AGENT_COLORS, EGO, INK, SIGNAL_COLORS
from scjax.viz.log_frames import LogFrames
from scjax.viz.video_file import video_suffix, write_video

MAX_FRAMES, MAX_GIF_FRAMES = 3000, 600
"""Of one animation; GIFs are held in memory until they are whole."""

_RADIUS, _MAX_RADIUS = 40.0, 5000.0  # m
_SIZES = (64, 2160)  # pixels


def animate(
    log: Log,
    path: str | Path,
    *,
    object_index: int | None = None,
    radius: float | None = None,
    frames_per_second: float = 10.0,
    size: int = 480,
    heading_up: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> None:
    """Writes an animation of a log, at its own speed. The ending of ``path`` chooses: .gif, or .mp4 (H.264).

    Args:
      path: of the file.
      object_index, radius, frames_per_second, size, heading_up: as in ``frames_of``.
      progress: is called after each frame with the number of frames so far and of all.

    Raises:
      ValueError: another ending; PyAV is missing for an MP4; or as ``frames_of``.
    """
    video_suffix(path)
    view = {"object_index": object_index, "radius": radius, "size": size, "heading_up": heading_up}
    frames = frames_of(log, frames_per_second=frames_per_second, **view)
    steps = frame_steps(log, frames_per_second)
    if video_suffix(path) == ".gif" and len(steps) > MAX_GIF_FRAMES:
        raise ValueError(f"{path}: {len(steps)} frames are more than a GIF may have, {MAX_GIF_FRAMES}: write an .mp4")
    times = log.timestamps[steps]

    def counted() -> Iterator[np.ndarray]:
        for number, frame in enumerate(frames, 1):
            yield frame
            if progress is not None:
                progress(number, len(steps))

    colors = (EGO, INK, *AGENT_COLORS.values(), *SIGNAL_COLORS.values())
    write_video(counted(), path, float((len(steps) - 1) / (times[-1] - times[0])), colors)


def frames_of(
    log: Log,
    *,
    object_index: int | None = None,
    radius: float | None = None,
    frames_per_second: float = 10.0,
    size: int = 480,
    heading_up: bool = False,
) -> Iterator[UInt8[np.ndarray, "size size 3"]]:
    """The RGB frames of an animation one after the other, each drawn when it is due.

    Roads are bands with marks of their direction. Lines across lanes are signals at their stop points, or at the start
    of the lane where a log does not say. Agents show their front by a windscreen or a nose, and where they came from.

    Args:
      object_index: the object in the middle, by default the ego; without an ego the picture stands still.
      radius: from the middle to the edge of the picture [m]; by default 40, or as far as objects go if it stands still.
      frames_per_second: at most; not more than the log has.
      size: width and height [pixels], even.
      heading_up: turn the picture so that the object in the middle looks up, and show more ahead of it than behind.

    Raises:
      ValueError: the log has one step only, gives too many frames, breaks an invariant (``validate_log``) or has no
        such object; an argument is out of range. Raised at once, before the first frame.
    """
    steps = frame_steps(validate_log(log), frames_per_second)
    index = log.ego_index if object_index is None else object_index
    if not NO_EGO <= index < log.num_objects:
        raise ValueError(f"object_index is {index}: give one of the {log.num_objects} objects of the log")
    if index != NO_EGO and not log.valid[index].any():
        raise ValueError(
            f"object_index is {index}, but object {log.object_ids[index]} is valid at no step: follow another"
        )
    if heading_up and index == NO_EGO:
        raise ValueError("heading_up turns with an object, but the log has no ego: give object_index")
    if not _SIZES[0] <= size <= _SIZES[1] or size % 2:
        raise ValueError(f"size is {size} pixels: give an even number from {_SIZES[0]} to {_SIZES[1]}")
    center, reach = _extent(log)
    if radius is None:
        radius = max(_RADIUS, reach) if index == NO_EGO else _RADIUS
    if not 1.0 <= radius <= _MAX_RADIUS:
        raise ValueError(f"radius is {radius} m: give a number from 1 to {_MAX_RADIUS:.0f}")
    view = LogFrames(log, index, center, float(radius), size, heading_up=heading_up)
    return (view.draw(int(step)) for step in steps)


def frame_steps(log: Log, frames_per_second: float = 10.0) -> Int[np.ndarray, " frames"]:
    """The steps of a log that an animation shows.

    Raises:
      ValueError: there is one step only; there are more than ``MAX_FRAMES``; the number is out of range.
    """
    if log.num_steps < 2:
        raise ValueError("the log has one step, which makes no animation: give one with more steps")
    if not 0.01 <= frames_per_second <= 1000:
        raise ValueError(f"frames_per_second is {frames_per_second}: give a number from 0.01 to 1000")
    times = log.timestamps - log.timestamps[0]
    pause = max(1.0 / frames_per_second, log.dt)
    if times[-1] / pause > MAX_FRAMES:
        raise ValueError(
            f"{times[-1] / pause:.0f} frames are more than {MAX_FRAMES}: cut the log or lower frames_per_second"
        )
    frames = np.arange(0.0, times[-1] + 1e-9, pause)
    after = np.searchsorted(times, frames).clip(1, len(times) - 1)
    steps = np.unique(np.where(frames - times[after - 1] <= times[after] - frames, after - 1, after))
    return steps if len(steps) > 1 else np.array([0, len(times) - 1])


def _extent(log: Log) -> tuple[np.ndarray, float]:
    """Middle of all objects [2], or of the map without any, and half the longer side of the box around them [m]."""
    points = log.positions[log.valid][:, :2]
    if not len(points):
        points = np.concatenate([lane.points[:, :2] for lane in log.lanes] or [np.zeros((1, 2))])
    low, high = points.min(0), points.max(0)
    return (low + high) / 2, float((high - low).max() / 2 + 10.0)
