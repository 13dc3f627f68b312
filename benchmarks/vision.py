"""How many pictures a second does one core encode? python -m benchmarks.vision

Networks of published sizes with random weights. Times are processor seconds of all threads, the least of a few
repeats, so that other work on the machine changes them little; a rate is that of one core.
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Callable

import jax
import numpy as np
from PIL import Image

from benchmarks.workload import table
from scjax.camera.photo import photo_from_array
from scjax.encoders.base import pure_functions
from scjax.encoders.depth import DEPTH_NETWORKS, FrozenDepthNetwork
from scjax.encoders.image_network import LoadedNetwork
from scjax.encoders.preprocessing import SQUASH, prepare_image
from scjax.encoders.vision import IMAGE_NETWORKS, FrozenImageEncoder

_SMALL = {"hidden_size": 384, "num_hidden_layers": 12, "num_attention_heads": 6}
_DINOV2 = {**_SMALL, "model_type": "dinov2", "patch_size": 14, "image_size": 518}
NETWORKS = {
    "DINOv2-S/14": _DINOV2,
    "DINOv3-S/16": {"model_type": "dinov3_vit", "num_register_tokens": 4},
    "Depth-Anything-V2-Small": {
        "model_type": "depth_anything",
        "backbone_config": {**_DINOV2, "out_indices": [3, 6, 9, 12]},
    },
}
"""Name -> what its config.json says of sizes."""


def random_network(name: str, compute: str) -> LoadedNetwork:
    """A network with random weights."""
    content = NETWORKS[name]
    network = {**IMAGE_NETWORKS, **DEPTH_NETWORKS}[content["model_type"]]
    config = network.read_config(content).with_compute(compute)
    return LoadedNetwork(network, config, pure_functions(network, config).init(jax.random.key(0)), name)


def core_seconds(run: Callable[[], object], repeats: int) -> float:
    """The least processor time of a call, after one that compiles."""
    run()
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
    return min(times)


def main() -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.vision", description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--smoke", action="store_true", help="one repeat and no depth, to see that it runs")
    args = parser.parse_args()
    repeats = 1 if args.smoke else args.repeats
    pixels = np.asarray(Image.effect_noise((1600, 900), 40).convert("RGB"))
    photos = [photo_from_array(np.roll(pixels, seed, 0)) for seed in range(8)]
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "jpeg")
    rows = [_row("decode a JPEG of 1600 x 900", "", core_seconds(lambda: _decode(buffer), repeats))]
    squash = core_seconds(lambda: prepare_image(photos[0], SQUASH, 16), repeats)
    rows.append(_row("resize it to 224 x 224", "", squash))
    for name in ("DINOv2-S/14", "DINOv3-S/16"):
        for compute in ("float32", "bfloat16"):
            encoder = FrozenImageEncoder(random_network(name, compute))
            side = 14 * encoder.config.patch_size
            for number in (1, 8):
                run = core_seconds(lambda run=encoder, n=number: run(photos[:n]), repeats) / number - squash
                rows.append(_row(f"{name}, {side} x {side}, {number} at once", compute, run))
    for shorter in () if args.smoke else (252, 518):
        network = FrozenDepthNetwork(random_network("Depth-Anything-V2-Small", "float32"), shorter)
        height, width = network.input_size((900, 1600))
        seconds = core_seconds(lambda run=network: run(photos[0]), max(1, repeats // 2))
        rows.append(_row(f"Depth-Anything-V2-Small, {height} x {width}", "float32", seconds))
    print(table(rows))


def _decode(buffer: io.BytesIO) -> np.ndarray:
    buffer.seek(0)
    return np.asarray(Image.open(buffer))


def _row(what: str, compute: str, seconds: float) -> dict[str, object]:
    return {"what": what, "precision": compute, "core ms": f"{1e3 * seconds:.0f}", "a second": f"{1 / seconds:.1f}"}


if __name__ == "__main__":
    main()
