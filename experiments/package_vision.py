"""Makes the vision network that comes with scjax out of a trained one.

    python -m experiments.package_vision runs/vision/model

Weights become float16. The notes keep the sizes and steps of the training, not its folders.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from experiments.packaged_folder import replace_packaged
from experiments.studies.page import script_parser
from scjax.encoders.base import CONFIG_FILE
from scjax.encoders.dashcam_weights import MODEL_TYPE, NETWORK, DashcamWeights
from scjax.encoders.image_network import load_network
from scjax.generate.picture_networks import EMBEDDED_VISION

_FOLDERS = ("pictures", "init_from")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.package_vision", __doc__)
    parser.add_argument("network", type=Path, help="folder of a trained vision network")
    parser.add_argument("--out", type=Path, default=EMBEDDED_VISION, help="folder to replace (default: the package's)")
    args = parser.parse_args(arguments)
    try:
        loaded = load_network(args.network, {MODEL_TYPE: NETWORK}, "float32")
        notes = json.loads((args.network / CONFIG_FILE).read_text()).get("notes", {})
        config = {name: value for name, value in notes.get("config", {}).items() if name not in _FOLDERS}
        weights = DashcamWeights(loaded.config, loaded.params, {**notes, "config": config})
        replace_packaged(args.out, lambda folder: weights.save(folder, dtype="float16"))
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.package_vision: {error}")


if __name__ == "__main__":
    main()
