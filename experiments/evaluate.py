"""python -m experiments.evaluate --config=experiments/configs/evaluate.py:standard --workdir=runs/e

The same as ``scjax evaluate``. Variants and fields: scjax/evaluate/config.py.
"""

from __future__ import annotations

import sys

from scjax.cli import main

if __name__ == "__main__":
    main(["evaluate", *sys.argv[1:]])
