"""Makes the reader of prompts that comes with scjax out of a trained one.

    python -m experiments.package_reader runs/reader/model

Weights become float16. What the demo's prompts ask for is stored with them, so that these need no encoder.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from experiments.packaged_folder import replace_packaged
from experiments.studies.page import script_parser
from scjax.cli.demo import PROMPTS
from scjax.generate.prompt_reader import DEFAULT_READER, INDEX, load_reader, save_reader


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.package_reader", __doc__)
    parser.add_argument("reader", type=Path, help="folder of a trained reader")
    parser.add_argument("--out", type=Path, default=DEFAULT_READER, help="folder to replace (default: the package's)")
    args = parser.parse_args(arguments)
    try:
        reader = dataclasses.replace(load_reader(args.reader), readings={})
        reader(PROMPTS)
        notes = json.loads((args.reader / INDEX).read_text())["notes"]
        replace_packaged(args.out, lambda folder: save_reader(reader, folder, notes))
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.package_reader: {error}")


if __name__ == "__main__":
    main()
