"""Gives a model other outlines of the windows that pictures show: those of the training split of some records.

    scjax data synthetic runs/roads --worlds 650 --seed 501
    python -m experiments.window_outlines --records runs/roads

The map from pictures to numbers of kinds stays, so no pictures are needed. No weight of a network changes.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import scjax
from experiments.studies.page import script_parser
from experiments.try_outlines import write_model
from scjax.generate.model import DEFAULT_MODEL
from scjax.nn.startup import start_jax
from scjax.train.objectives.record_views import MOST, windows_of_records


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.window_outlines", __doc__)
    parser.add_argument("--model", type=Path, default=DEFAULT_MODEL, help="folder (default: the model that ships)")
    parser.add_argument("--records", required=True, help="record folder with a split train")
    args = parser.parse_args(arguments)
    start_jax()
    try:
        model = scjax.load(args.model)
        write_model(with_windows(model, args.records), args.model)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.window_outlines: {error}")


def with_windows(model: scjax.Model, records: str) -> scjax.Model:
    """The model with outlines of the windows of records; at most ``MOST``, evenly spread.

    Raises:
      ValueError: it chooses no outlines by pictures.
    """
    if model.views is None:
        raise ValueError("this model chooses no outlines by pictures: train a denoiser on pictures first")
    config = model.denoiser.config
    found = windows_of_records(records, model.codec, (config.max_agents, config.max_lanes))
    rows = np.unique(np.linspace(0, len(found.domains) - 1, min(len(found.domains), MOST)).astype(int))
    views = dataclasses.replace(
        model.views,
        lanes=found.lanes[rows].astype(model.views.lanes.dtype),
        agents=found.agents[rows].astype(model.views.agents.dtype),
        domains=found.domains[rows].astype(model.views.domains.dtype),
        roads=found.roads[rows],
    )
    views.check()
    return dataclasses.replace(model, views=views)


if __name__ == "__main__":
    main()
