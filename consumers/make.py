"""Makes the environments of consumers: python -m consumers.make NAME ... [--root DIR]"""

from __future__ import annotations

import argparse
from pathlib import Path

from consumers.environments import NAMES, default_root, make_environment


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m consumers.make", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)} (default: all)")
    parser.add_argument("--root", type=Path, help=f"folder of the environments (default: {default_root()})")
    args = parser.parse_args()
    for name in args.names or NAMES:
        print(make_environment(name, args.root), flush=True)


if __name__ == "__main__":
    main()
