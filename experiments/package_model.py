"""Makes the model that comes with scjax out of a trained one.

    python -m experiments.package_model --model=runs/text/model --counter=runs/counter/model --steer

Weights become float16 in files of at most 15 MB and are multiplied in float32, the same on every machine; the demo's
prompts get their token features, and of the training only what a user can use is kept: steps, sizes, the hash of the
records. The model card (README.md) in the folder stays.
Only models trained on the synthetic world may ship: the licences of recordings do not allow it.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

import scjax
from experiments.studies.page import script_parser
from scjax.cli.demo import PROMPTS
from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.encoders import TextEncoder, load_text_encoder
from scjax.generate.components import Model
from scjax.generate.model import DEFAULT_MODEL, INDEX
from scjax.generate.model_format import index_hash
from scjax.nn.safetensors import read_arrays, sha256_of
from scjax.scene.per_type import PerType
from scjax.synthetic.domains import DOMAINS

_FILE, _ALL = 15.0, 60.0  # megabytes at most
_CARD = "README.md"
_PARTS = ("autoencoder", "denoiser", "count_predictor")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.package_model", __doc__)
    parser.add_argument("--model", required=True, help="trained model folder with denoiser and counter")
    parser.add_argument(
        "--out", type=Path, default=DEFAULT_MODEL, help="folder to replace (default: the package's own)"
    )
    parser.add_argument(
        "--temperature", type=float, nargs=2, metavar=("AGENTS", "LANES"), help="of sampling (default: the model's)"
    )
    parser.add_argument("--num-steps", type=int, help="of sampling by default (default: the model's)")
    parser.add_argument("--guidance", type=float, help="scale by default, 1 is none (default: the model's)")
    parser.add_argument(
        "--counter", dest="count_predictor", help="model folder whose counts are taken (default: the model's own)"
    )
    parser.add_argument("--sharpness", type=float, help="of the counts that are drawn (default: the counter's)")
    parser.add_argument("--steps", type=int, help="of the denoiser in all its trainings (default: of the last)")
    parser.add_argument(
        "--steer", action="store_true", help="sampling steers by default (scjax.diffusion.energy_guidance)"
    )
    args = parser.parse_args(arguments)
    try:
        model = scjax.load(args.model)
        if args.count_predictor:
            model = counted(model, scjax.load(args.count_predictor))
        if args.sharpness and "count_predictor" in model.components:
            counts = dataclasses.replace(model.count_predictor.config, sharpness=args.sharpness)
            model = model.with_component("count_predictor", counts, model.count_predictor.params)
        if args.steps:
            model = dataclasses.replace(model, notes={**model.notes, "steps": args.steps})
        if args.steer:
            model = dataclasses.replace(model, energy_guidance=EnergyGuidance())
        if args.temperature:
            model = dataclasses.replace(
                model, temperature=PerType(agents=args.temperature[0], lanes=args.temperature[1])
            )
        given = {"num_steps": args.num_steps, "guidance": args.guidance}
        model = dataclasses.replace(model, **{name: value for name, value in given.items() if value is not None})
        files = ship(model, args.out)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.package_model: {error}")
    for name, size in files.items():
        print(f"{size:6.2f} MB  {name}")


def counted(model: Model, other: Model) -> Model:
    """``model`` with the counts of another training, which must have read the same texts, or requests alone.

    Raises:
      ValueError: they read features of different text encoders.
    """
    if model.text_encoder != other.text_encoder and not other.count_predictor.config.attributes:
        raise ValueError(f"counts learnt from {other.text_encoder} features do not fit {model.text_encoder}")
    notes = {**model.notes, "count_predictor": other.notes.get("count_predictor", {})}
    components = {**model.components, "count_predictor": other.count_predictor}
    return dataclasses.replace(model, components=components, notes=notes)


def ship(model: Model, out: Path, encoder: TextEncoder | None = None) -> dict[str, float]:
    """Writes the folder and returns file name -> megabytes.

    Args:
      encoder: of the demo's prompts; by default the one that is found or fetched. A model without text needs none.

    Raises:
      ValueError: a part is missing, a domain is not of the synthetic world, or the files are too large.
    """
    for part in _PARTS:
        if part not in model.components:
            raise ValueError(f"the model has no {part}: train that stage first")
    foreign = set(model.domains) - {domain.name for domain in DOMAINS}
    if foreign:
        raise ValueError(f"the model was trained on {', '.join(sorted(foreign))}: only the synthetic world may ship")
    prompts = _demo_features(model, encoder or load_text_encoder()) if model.text_encoder else {}
    card = (out / _CARD).read_text() if (out / _CARD).is_file() else None
    network = dataclasses.replace(model.denoiser.config, compute="float32")
    shipped = model.with_component("denoiser", network, model.denoiser.params)
    shipped = dataclasses.replace(shipped, prompts=prompts, notes=public_notes(model.notes))
    if not _save_beside(shipped, out):
        scjax.save(shipped, out, dtype="float16", largest=_FILE)
        if card is not None:
            (out / _CARD).write_text(card)
    files = {path.name: path.stat().st_size / 1e6 for path in sorted(out.iterdir())}
    if sum(files.values()) > _ALL:
        raise ValueError(f"{out} has {sum(files.values()):.0f} MB, more than {_ALL:.0f}: train a smaller model")
    return files


def _save_beside(model: Model, out: Path) -> bool:
    """Keeps the files of weights in ``out`` of which the model has all arrays, and writes the others in one more.

    So a network that was trained on a frozen one changes its own weights alone. False, and nothing is written, if no
    file can stay.
    """
    if not (out / INDEX).is_file():
        return False
    files = json.loads((out / INDEX).read_text())["files"]
    stored = {name: read_arrays(out, {name: digest}) for name, digest in files.items()}
    with tempfile.TemporaryDirectory() as folder:
        scjax.save(model, folder, dtype="float16")
        index = json.loads((Path(folder) / INDEX).read_text())
        arrays = safetensors.numpy.load_file(Path(folder) / "weights.safetensors")
    kept = [
        name
        for name, own in stored.items()
        if all(key in arrays and np.array_equal(value, arrays[key].astype(value.dtype)) for key, value in own.items())
    ]
    if not kept:
        return False
    others = {key: value for key, value in arrays.items() if not any(key in stored[name] for name in kept)}
    name = next(f"weights-{k}.safetensors" for k in range(1, len(files) + 2) if f"weights-{k}.safetensors" not in kept)
    index["files"] = {one: files[one] for one in kept}
    if others:
        (out / name).write_bytes(safetensors.numpy.save(others))
        index["files"][name] = sha256_of(out / name)
    index["checked"] = index_hash(index)
    (out / INDEX).write_text(json.dumps(index, indent=1, allow_nan=False))
    for old in files.keys() - index["files"].keys():
        (out / old).unlink()
    return True


def _demo_features(model: Model, encoder: TextEncoder) -> dict[str, np.ndarray]:
    if encoder.name != model.text_encoder:
        raise ValueError(f"the model was trained with {model.text_encoder}, but the encoder here is {encoder.name}")
    return {text: np.asarray(one.features) for text, one in zip(PROMPTS, encoder(PROMPTS), strict=True)}


def public_notes(notes: dict[str, Any]) -> dict[str, Any]:
    """Of the notes of training: steps of every stage and the hash of the records, no folders of the machine.

    Those of a model that ships already stay as they are.
    """
    if "licence" in notes:
        return notes
    stages = {
        "denoiser": notes,
        "autoencoder": notes.get("autoencoder", {}),
        "count_predictor": notes.get("count_predictor", {}),
    }
    batches = {name: stage["config"]["batch"] for name, stage in stages.items() if "config" in stage}
    return {
        "data": "the synthetic world of scjax, nothing else",
        "licence": "Apache-2.0",
        "records": notes.get("records", ""),
        "steps": {name: stage["steps"] for name, stage in stages.items() if "steps" in stage},
        "batch_size": {name: batch["batch_size"] for name, batch in batches.items()},
    }


if __name__ == "__main__":
    main()
