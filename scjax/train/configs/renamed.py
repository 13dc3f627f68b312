"""Names of config fields before and after their renaming, so that an old name is answered with the new one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

RENAMED = {
    "control": "cross_attention",
    "control_options": "cross_attention_options",
    "count_given": "count_known",
    "counter": "counts",
    "hints": "relative_geometry",
    "joints": "connections",
    "lane_joint": "lane_connection",
    "lane_joints": "lane_connections",
    "lanes_given": "known_lanes_share",
    "layouts": "crops",
    "offsets": "lateral_offsets",
    "optimiser": "optimizer",
    "representation": "codec",
    "stage": "objective",
    "start": "init_from",
    "waves": "fourier_features",
}
"""Old name of a field -> new name."""


def check_renamed(fields: Iterable[str]) -> None:
    """Refuses old names in dotted fields ("optimiser.kind").

    Raises:
      ValueError: a field has an old name; the message has the new one.
    """
    for field in fields:
        renamed = ".".join(RENAMED.get(part, part) for part in field.split("."))
        if renamed != field:
            raise ValueError(f"config.{field} is now called config.{renamed}")


def dotted_fields(config: Mapping[str, Any], prefix: str = "") -> list[str]:
    """All fields of a nested config, dotted; the options of a mechanism are not renamed and not listed."""
    fields = []
    for name, value in config.items():
        fields.append(prefix + name)
        if isinstance(value, Mapping) and name != "cross_attention_options":
            fields += dotted_fields(value, f"{prefix}{name}.")
    return fields
