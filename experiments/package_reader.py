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

from experiments.studies.page import script_parser
from scjax.cli.demo import PROMPTS
from scjax.generate.prompt_reader import DEFAULT_READER, INDEX, load_reader, save_reader

_CARD = "README.md"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.package_reader", __doc__)
    parser.add_argument("reader", type=Path, help="folder of a trained reader")
    parser.add_argument("--out", type=Path, default=DEFAULT_READER, help="folder to replace (default: the package's)")
    args = parser.parse_args(arguments)
    try:
        reader = dataclasses.replace(load_reader(args.reader), readings={})
        reader(PROMPTS)
        notes = json.loads((args.reader / INDEX).read_text())["notes"]
        card = (args.out / _CARD).read_text() if (args.out / _CARD).is_file() else None
        save_reader(reader, args.out, notes)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.package_reader: {error}")
    if card is not None:
        (args.out / _CARD).write_text(card)
    for path in sorted(args.out.iterdir()):
        print(f"{path.stat().st_size / 1e6:6.2f} MB  {path.name}")


if __name__ == "__main__":
    main()
