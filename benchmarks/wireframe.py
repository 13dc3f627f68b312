"""How many wireframes a second does one core draw, and what do depth, ids and an MP4 add?

    python -m benchmarks.wireframe          # 600 lines a frame, and a log of the synthetic world
    python -m benchmarks.wireframe LOG      # a log or recording of any format as well

The process keeps to one core. Times are medians over frames, on the clock and of the processor.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from scjax.camera import WireframeRenderer, WireframeStyle
from scjax.scene import AgentType, Log, MapLane

SIZE, STEPS = (1280, 704), 60
REPEATS = list(range(5))  # of a video
BOXES, LANES, LANE_LENGTH = 40, 5, 64.0
"""A box has 12 edges and two diagonals; a lane has a line for each 8 m: 600 lines with both."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", nargs="?")
    path = parser.parse_args().log
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    logs = {"600 lines": street(), "synthetic world": _world()}
    if path is not None:
        from scjax.data.imports import import_log

        logs["LOG"] = import_log(path)
    print(f"{SIZE[0]} x {SIZE[1]} pixels, one core, load {os.getloadavg()[0]:.1f}")
    for name, log in logs.items():
        measure(name, log)


def measure(name: str, log: Log) -> None:
    """Prints the frame rates of a log."""
    for occlusion in (True, False):
        start = time.perf_counter()
        renderer = WireframeRenderer(
            log, "dashcam", style=WireframeStyle(occlusion=occlusion, borders=name != "600 lines")
        )
        ready = time.perf_counter() - start
        steps = renderer.steps[:STEPS].tolist()
        lines = np.mean([renderer.frame(step).num_lines for step in steps])
        clock, processor = _median(renderer.frame, steps)
        print(
            f"{name}, occlusion {occlusion}: {lines:.0f} lines a frame, {1 / clock:.0f} frames/s on the clock, "
            f"{1 / processor:.0f} of the processor; ready after {ready:.2f} s"
        )
        clock, _ = _median(lambda step, r=renderer: r.frame(step, buffers=True), steps[:10])
        print(f"{name}, occlusion {occlusion}: {1 / clock:.0f} frames/s with depth, ids and kinds")
        _print_video(f"{name}, occlusion {occlusion}", renderer)


def _print_video(name: str, renderer: WireframeRenderer) -> None:
    """Frames a second of drawing and writing together, on the clock and of the processor, and of the parts."""
    from scjax.viz.video_file import write_video

    with tempfile.TemporaryDirectory() as folder:
        path, steps = Path(folder) / "clip.mp4", renderer.steps[:STEPS]
        clock, processor = _median(lambda _: write_video(renderer.frames(steps), path, 10.0), REPEATS)
        frames = list(renderer.frames(steps))
        _, writing = _median(lambda _: write_video(frames, path, 10.0), REPEATS)
        size, error = path.stat().st_size, _error(path, frames)
    clock, processor, writing = (1000 * seconds / len(steps) for seconds in (clock, processor, writing))
    print(
        f"{name}: {1000 / clock:.0f} frames/s drawn and written as mp4 on the clock, {1000 / processor:.0f} of the "
        f"processor; a frame takes {processor - writing:.1f} ms to draw and {writing:.1f} ms to write, "
        f"{size / 1000 / len(steps):.1f} kB, PSNR {10 * np.log10(255**2 / error):.1f} dB"
    )


def _error(path: Path, frames: list[np.ndarray]) -> float:
    """Mean squared error of the colors of a video."""
    import av

    with av.open(str(path)) as container:
        read = [picture.to_ndarray(format="rgb24") for picture in container.decode(video=0)]
    return float(np.mean([((a.astype(float) - b) ** 2).mean() for a, b in zip(read, frames, strict=True)]))


def _median(run: Callable[[int], object], steps: list[int]) -> tuple[float, float]:
    """Seconds on the clock and of the processor, the medians over steps."""
    times = []
    for step in steps:
        clock, processor = time.perf_counter(), time.process_time()
        run(step)
        times.append((time.perf_counter() - clock, time.process_time() - processor))
    clock, processor = np.median(times, 0).tolist()
    return clock, processor


def street() -> Log:
    """An ego on a street of five lanes with 40 boxes ahead of it that it approaches; all are in the picture."""
    rng = np.random.default_rng(0)
    lanes = tuple(
        MapLane(str(k), "surface_street", np.array([(x, y, 0.0) for x in (8.0, 8.0 + LANE_LENGTH)]))
        for k, y in enumerate(np.arange(LANES) * 3.5 - 7.0)
    )
    x = np.linspace(16.0, 70.0, BOXES)
    places = np.column_stack([x, rng.uniform(-0.4, 0.4, BOXES) * x, np.full(BOXES, 0.8)])
    positions = np.repeat(np.concatenate([[[0.0, 0.0, 0.8]], places])[:, None], STEPS, 1)
    positions[0, :, 0] = 0.1 * np.arange(STEPS)
    count = BOXES + 1
    headings = np.repeat(np.concatenate([[0.0], rng.uniform(-np.pi, np.pi, BOXES)])[:, None], STEPS, 1)
    return Log(
        timestamps=0.1 * np.arange(STEPS),
        object_ids=tuple(map(str, range(count))),
        object_types=np.full(count, AgentType.VEHICLE),
        valid=np.ones((count, STEPS), bool),
        positions=positions,
        headings=headings,
        velocities=np.zeros((count, STEPS, 2)),
        sizes=np.full((count, 3), [4.5, 1.9, 1.6]),
        ego_index=0,
        signal_lane_ids=(),
        signal_states=np.zeros((0, STEPS), int),
        signal_positions=np.zeros((0, 3)),
        lanes=lanes,
        has_topology=True,
    )


def _world() -> Log:
    from scjax.synthetic.motion import world_logs

    log = world_logs(7, 0)[0]
    return log if log.ego_index >= 0 else dataclasses.replace(log, ego_index=0)


if __name__ == "__main__":
    main()
