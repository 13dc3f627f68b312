"""How many rendered dashcam pictures of 224 x 224 pixels a second does one core make?

    python -m benchmarks.dashcam          # a log of the synthetic world, and single scenes
    python -m benchmarks.dashcam LOG      # a log or recording of any format as well

The process keeps to one core. Sequences keep their windows of the ground; single scenes pay for everything once a
picture. Times are of the processor, with those on the clock beside them.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
from collections.abc import Callable

from scjax.camera import preset_rig
from scjax.camera.dashcam import DashcamRenderer, random_look
from scjax.camera.raster import require_opencv
from scjax.camera.rig import Rig
from scjax.camera.standard_view import standard_camera
from scjax.scene import Log

SIZE, STEPS, SCENES = (224, 224), 60, 30


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", nargs="?")
    path = parser.parse_args().log
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    require_opencv().setNumThreads(1)
    print(f"{SIZE[0]} x {SIZE[1]} pixels, one core, load {os.getloadavg()[0]:.1f}")
    logs = _worlds()
    sequences = {"synthetic world": logs[0]}
    if path is not None:
        from scjax.data.imports import import_log

        sequences["LOG"] = import_log(path)
    rig = preset_rig("dashcam").fitted(*SIZE)
    for name, log in sequences.items():
        for lens in (0.0, -0.1):
            for supersampling in (1, 2):
                look = dataclasses.replace(random_look(0, "clear"), lens=lens)
                renderer = DashcamRenderer(log, rig, look=look, supersampling=supersampling)
                steps = renderer.steps[:STEPS].tolist()
                rates = _rates(renderer.frame, steps)
                print(f"{name}, lens {lens}, {supersampling} x {supersampling} samples a pixel: {rates}")
    # What scjax data dashcam draws.
    standard = Rig(name="standard", cameras=(standard_camera(),))
    renderer = DashcamRenderer(logs[0], standard, look=random_look(0, "clear"), supersampling=2)
    rates = _rates(renderer.frame, renderer.steps[:STEPS].tolist())
    print(f"synthetic world, standard view, 2 x 2 samples a pixel: {rates}")
    moments = [log[step : step + 1] for log in logs for step in range(0, 90, 30) if log.valid[log.ego_index, step]]
    moments = moments[:SCENES]
    rates = _rates(lambda k: DashcamRenderer(moments[k], rig, look=random_look(k)).frame(0), list(range(len(moments))))
    print(f"single moments of synthetic worlds, another look each: {rates}")


def _rates(run: Callable[[int], object], items: list[int]) -> str:
    """Pictures a second, without the first."""
    run(items[0])
    clock, processor = time.perf_counter(), time.process_time()
    for item in items[1:]:
        run(item)
    count = len(items) - 1
    return (
        f"{count / (time.process_time() - processor):.0f} pictures/s of the processor, "
        f"{count / (time.perf_counter() - clock):.0f} on the clock"
    )


def _worlds() -> list[Log]:
    from scjax.synthetic.motion import world_logs

    logs = [log for seed in (7, 8, 9) for log in world_logs(seed, 1)]
    return [log if log.ego_index >= 0 else dataclasses.replace(log, ego_index=0) for log in logs]


if __name__ == "__main__":
    main()
