"""Makes the behavior that comes with scjax out of a trained one.

    python -m experiments.package_behavior runs/behavior/model --data "900 logs of 300 worlds"

Weights become float16. The notes keep the sizes and steps of the training, not its folders.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

from experiments.packaged_folder import replace_packaged
from experiments.studies.page import script_parser
from scjax.sim.behavior_weights import DEFAULT_BEHAVIOR, load_behavior

_FOLDERS = ("logs", "cache", "init_from")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.package_behavior", __doc__)
    parser.add_argument("behavior", type=Path, help="folder of a trained behavior")
    parser.add_argument("--data", required=True, help="what it was trained on")
    parser.add_argument("--out", type=Path, default=DEFAULT_BEHAVIOR, help="folder to replace (default: the package's)")
    args = parser.parse_args(arguments)
    try:
        weights = load_behavior(args.behavior)
        config = {name: value for name, value in weights.notes.get("config", {}).items() if name not in _FOLDERS}
        notes = {**weights.notes, "config": config, "data": args.data}
        shipped = dataclasses.replace(weights, notes=notes)
        replace_packaged(args.out, lambda folder: shipped.save(folder, dtype="float16"))
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.package_behavior: {error}")


if __name__ == "__main__":
    main()
