"""Folders of ``dashcam_network``: reading them as any published network, and writing them after training."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

from scjax.encoders.base import CONFIG_CURE, CONFIG_FILE, PublishedNetwork, pure_functions
from scjax.encoders.dashcam_network import DashcamConfig, DashcamNetwork
from scjax.nn.functional import Functional, Params, flatten
from scjax.nn.state_dict import SAME, Rules, export
from scjax.scene.document import convert_document
from scjax.scene.files import whole_folder

MODEL_TYPE = "scjax_dashcam"
"""``model_type`` of its ``config.json``."""

_WEIGHTS = "model.safetensors"


def takes_standard_views(encoder: str) -> bool:
    """Whether an encoder of this name reads standard views alone (``camera.standard_view``)."""
    return encoder.startswith(f"{MODEL_TYPE}-")


def dashcam_config(content: Mapping[str, Any]) -> DashcamConfig:
    """Sizes from the content of a ``config.json``.

    Raises:
      ValueError: a field of another type or out of its range.
    """
    return convert_document(dict(content), DashcamConfig, CONFIG_FILE, CONFIG_CURE)


def dashcam_weight_rules(config: DashcamConfig) -> Rules:
    """Keys of the weights -> parameters: their paths."""
    return {".".join(map(str, path)): (path, SAME) for path in flatten(dashcam_functions(config).shapes())}


def dashcam_table_shapes(config: DashcamConfig) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays that decide all sizes."""
    return {
        "stem.kernel": (48, config.stem),
        "to_fine.kernel": (4 * config.stem, config.fine),
        "positions": (config.rows * config.columns, config.hidden_size),
        "features.kernel": (config.hidden_size, config.features),
    }


NETWORK = PublishedNetwork(
    read_config=dashcam_config,
    module=DashcamNetwork,
    table_shapes=dashcam_table_shapes,
    weight_rules=dashcam_weight_rules,
    is_unused=lambda name: False,
)


@dataclasses.dataclass(frozen=True)
class DashcamWeights:
    """A trained network of rendered dashcam pictures.

    Attributes:
      config: its sizes; params: its parameters.
      notes: free JSON: training data, steps.
    """

    config: DashcamConfig
    params: Params
    notes: dict[str, Any] = dataclasses.field(default_factory=dict)

    def save(self, folder: str | Path, *, dtype: str | None = None) -> Path:
        """Writes the folder and returns its path. An existing one is replaced at the end, as a whole.

        Args:
          dtype: of the stored parameters; "float16" halves them.
        """
        state = export(self.params, dashcam_weight_rules(self.config))
        stored = {key: np.asarray(array, dtype or np.float32) for key, array in state.items()}
        fields = dataclasses.asdict(self.config)
        del fields["compute"]
        content = {"model_type": MODEL_TYPE, **fields, "notes": self.notes}
        with whole_folder(Path(folder), "the vision network") as temporary:
            (temporary / _WEIGHTS).write_bytes(safetensors.numpy.save(stored))  # save_file hides files from others
            (temporary / CONFIG_FILE).write_text(json.dumps(content, indent=1, allow_nan=False))
        return Path(folder)


def dashcam_functions(config: DashcamConfig) -> Functional:
    """The network as ``init`` and ``apply``, which also runs the methods "cells" and "depth"."""
    return pure_functions(NETWORK, config)
