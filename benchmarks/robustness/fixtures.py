"""Sound inputs that the areas damage, made once by the code under test from its own test factories."""

from __future__ import annotations

import dataclasses
import gzip
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness import names
from benchmarks.robustness.case import Unavailable

PROMPT = "a road with two lanes"
"""The prompt whose features are kept in the model "text"."""
WIDTH = 5
HEADS = {"ae": (4, 4), "uncond": (4, 2), "text": (4, 2), "image": (4, 2)}
_STEPS, _SPARSE = 9, 20


class Words:
    """A text encoder without weights: features are drawn from the letters of a word."""

    name, width = "words-1", WIDTH

    def __call__(self, texts: list[str]) -> list[Any]:
        tokens = names.get("TokenFeatures")
        return [tokens(np.stack([_word(word) for word in text.split()]), tuple(text.split())) for text in texts]

    def is_cut(self, text: str) -> bool:
        return len(text.split()) > 50


def _word(word: str) -> np.ndarray:
    return np.random.default_rng(list(word.encode())).normal(size=WIDTH).astype(np.float32)


def build(folder: Path) -> None:
    """Makes every fixture; those that the code under test cannot make are left out, and named on stderr."""
    folder.mkdir(parents=True, exist_ok=True)
    steps: list[Callable[[Path], None]] = [_scenes, _recorded, _log, _records, _encoders, _models, _run, _official]
    for step in steps:
        mark = folder / f".{step.__name__}.done"
        if mark.exists():
            continue
        try:
            step(folder)
        except Unavailable as error:
            print(f"fixtures{step.__name__}: {error}", file=sys.stderr)
        mark.touch()


def _scenes(folder: Path) -> None:
    example, stack = names.get("example_scene"), names.get("stack")
    scene, batch = example(0, padding=1), stack([example(seed, agents=3, lanes=3, padding=1) for seed in range(3)])
    for name, one in (("scene", scene), ("batch", batch)):
        names.get("save_npz")(one, folder / f"{name}.npz")
        names.get("save_json")(one, folder / f"{name}.json")


def _recorded(folder: Path) -> None:
    """A short recording with few points, so that thousands of copies are cheap; its topology is listed."""
    content = names.get("scene_content")()
    content["timestamps"] = content["timestamps"][:_STEPS]
    content["has"] = {"z": True, "topology": "given"}
    content["tl_states"]["2"]["state"] = content["tl_states"]["2"]["state"][:_STEPS]
    for lane in content["map"]:
        for key in "xyz":
            lane[key] = [*lane[key][:-1:_SPARSE], lane[key][-1]]
        if lane["type"] == "lane":
            lane |= {"predecessors": [], "successors": [], "left_neighbors": [], "right_neighbors": []}
    content["map"][0] |= {"successors": [2, 3], "left_neighbors": [[4, 0, 5, 0, 5]]}
    content["map"][1]["predecessors"] = content["map"][2]["predecessors"] = [1]
    for one in content["objects"]:
        for key, value in one.items():
            if isinstance(value, list):
                one[key] = value[:_STEPS]
    (folder / "recordings").mkdir(exist_ok=True)
    for path in (folder / "recorded.json.gz", folder / "recordings/one.json.gz"):
        path.write_bytes(gzip.compress(json.dumps(content).encode(), mtime=0))
    names.get("read_recorded")(folder / "recorded.json.gz")


def _log(folder: Path) -> None:
    names.get("save_log")(names.get("example_log")(), folder / "log.npz")


def _records(folder: Path) -> None:
    options = names.get("BuildOptions")(split_percent=40.0, files_per_shard=2)
    names.get("build_records")(names.get("Worlds")(3, 6), folder / "records", options)
    names.get("add_captions")(folder / "records", progress=False)
    names.get("embed_captions")(folder / "records", Words(), progress=False)


def _encoders(folder: Path) -> None:
    write = names.get("write_encoder")
    write(folder / "bert")
    from scjax.encoders import t5

    words = json.loads((folder / "bert/config.json").read_text())["vocab_size"]
    write(
        folder / "umt5", t5.T5Config(vocab_size=words, d_model=16, d_kv=4, d_ff=24, num_layers=2, num_heads=2), "umt5"
    )


def _models(folder: Path) -> None:
    tiny, save = names.get("tiny_model"), names.get("save_model")
    save(tiny(), folder / "plain")
    text = tiny(names.get("TextCondition")(WIDTH))
    features = Words()([PROMPT])[0].features
    save(dataclasses.replace(text, text_encoder="words-1", prompts={PROMPT: features}), folder / "text")
    save(tiny(names.get("ImageCondition")(channels=3, grid=(2, 2), patch=1)), folder / "image")


def state_of(folder: Path) -> Any:
    """Parameters that stand for the state of a training."""
    del folder
    import jax

    model = names.get("tiny_model")()
    params = model.autoencoder if isinstance(model.autoencoder, dict) else model.autoencoder.params
    return {"params": jax.tree.map(jax.numpy.asarray, params), "step": jax.numpy.int32(3)}


RESOLVED = {"model": {"lane_width": 8}, "steps": 9}
DATA = {"next": 17, "waiting": [1, 2, 3]}


def _run(folder: Path) -> None:
    with names.get("Checkpoints")(folder / "checkpoints", RESOLVED) as checkpoints:
        checkpoints.save(3, state_of(folder), DATA, wait=True)


def _official(folder: Path) -> None:
    import safetensors.numpy

    parity = Path(os.environ.get("SCJAX_PARITY_DIR", Path(os.environ.get("SCJAX_SHARED", "../shared")) / "parity"))
    if not parity.is_dir():
        raise Unavailable(f"{parity} is not there: set SCJAX_PARITY_DIR")
    (folder / "official").mkdir(exist_ok=True)
    for name in HEADS:
        with np.load(parity / f"{name}_weights.npz") as file:
            arrays = {key: np.ascontiguousarray(file[key]) for key in file}
        safetensors.numpy.save_file(arrays, folder / f"official/{name}.safetensors")


if __name__ == "__main__":
    build(Path(sys.argv[1]))
