"""The page of the study of image control, and its examples."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from experiments.studies.image_control_measures import NEAR, RANGES
from experiments.studies.page import new_figure, table_lines
from scjax.camera.photo import Photo
from scjax.metrics.descriptors import LEVELS
from scjax.metrics.placement import THRESHOLDS
from scjax.scene import Scene
from scjax.scene.files import whole_file
from scjax.viz.bev import plot_scene
from scjax.viz.photo_view import small_pixels

Rows = dict[str, list[float]]
"""Name -> value, and the ends of its interval where there is one."""

MAX_BYTES = 50_000
"""Of the picture of examples."""

_WIDTH, _HEIGHT = 1.5 * 16 / 9, 1.5  # inches of a photo; scenes are square
_ASPECT = 16 / 9
_RANGE_COLUMNS = {f"{low}_{high}": f"{low}-{high} m" for low, high in RANGES}
_METERS = {f"{threshold:g}m": f"{threshold:g} m" for threshold in THRESHOLDS}


_SECTIONS: tuple[tuple[str, str, dict[str, str]], ...] = (
    (
        "Vehicles that are seen, with a generated one within",
        "",
        {
            **{f"vehicles_{key}": title for key, title in _METERS.items()},
            **{f"vehicles_2m_{key}": f"2 m: {title}" for key, title in _RANGE_COLUMNS.items()},
        },
    ),
    (
        "Points of lanes that are seen, with a generated lane of the same direction within",
        "",
        {
            **{f"lanes_{key}": title for key, title in _METERS.items()},
            **{f"lanes_2m_{key}": f"2 m: {title}" for key, title in _RANGE_COLUMNS.items()},
        },
    ),
    (
        f"What is in view and should not be, nearer than {NEAR} m",
        "Lanes within: points of generated lanes in view that have a true lane of their direction so near. Invented: "
        "vehicles on the road in view, where nothing is within 3 m; clearly, where nothing is within a fifth of their "
        "distance either.",
        {
            **{f"lanes_precise_{key}": f"lanes within {title}" for key, title in _METERS.items()},
            "invented": "invented, of vehicles",
            "invented_per_picture": "invented, per 100 pictures",
            "clearly_per_picture": "clearly invented, per 100 pictures",
            "overlapping": "vehicles that overlap",
        },
    ),
    (
        "As in the paper: all vehicles in the field of view",
        "",
        {
            "AP": "AP",
            **{
                f"{name}_{key}": f"{name} {title}" for name in ("recall", "precision") for key, title in _METERS.items()
            },
        },
    ),
    (
        "Control of the whole scene",
        "Times 100.",
        {f"{level} {name}": f"{name} {level}" for name in ("CCS", "SPG", "CSC") for level in LEVELS},
    ),
)
"""Title, explanation, and name -> head of the columns of every table of all rows."""

_AGREEMENT = (
    f"Samples of one picture agree in view and differ elsewhere, nearer than {NEAR} m",
    "Share of points of lanes that have a lane of another sample, of their direction, within 1 m. Share of vehicles "
    "that have another sample's within 2 m. Elsewhere is beside the field of view.",
    {
        f"{what}_{where}": f"{what} {where.replace('_', ' ')}"
        for what in ("lanes", "vehicles")
        for where in ("in_view", "elsewhere")
    },
)


def page_text(content: Mapping[str, Any], command: str, picture: str) -> str:
    """The page as markdown; all shares in %."""
    hidden = "boxes and buildings" if content["knows of buildings"] else "boxes"
    counted = ", ".join(
        f"{content[name]} {name}" for name in ("scenes", "locations", "vehicles seen", "samples of a picture")
    )
    lines = [
        *("# Image control", "", f"`{command}`", ""),
        f"{counted}. Shares in %, with 95 % intervals over locations. Single samples as drawn, at the model's "
        f"defaults. Seen is what lies in the picture, not behind {hidden}.",
    ]
    tables = [(section, content["rows"]) for section in _SECTIONS]
    for (title, explanation, columns), rows in [*tables, (_AGREEMENT, {"picture": content["agreement"]})]:
        lines += ["", f"## {title}", ""] + ([explanation, ""] if explanation else [])
        lines += table_lines(["", *columns.values()], _cells(rows, columns))
    lines += ["", "## Examples", "", "Picture, true scene, two samples; from many vehicles in sight to none.", ""]
    return "\n".join([*lines, f"![Pictures and scenes]({picture})", ""])


def _cells(rows: Mapping[str, Rows], columns: Mapping[str, str]) -> list[list[str]]:
    return [[name, *(_cell(row[key]) for key in columns)] for name, row in rows.items()]


def _cell(numbers: Sequence[float]) -> str:
    """A share in %, and its interval."""
    value, *bounds = (100 * x for x in numbers)
    if value != value:
        return "-"
    interval = f" ({bounds[0]:.0f}..{bounds[1]:.0f})" if bounds and bounds[0] == bounds[0] else ""
    return f"{value:.1f}{interval}"


def save_examples(examples: Sequence[tuple[Photo, list[Scene]]], path: Path) -> None:
    """Writes rows of a photo and scenes as a JPEG of at most ``MAX_BYTES``."""
    columns = max(len(scenes) for _, scenes in examples)
    figure = new_figure(_WIDTH + columns * _HEIGHT, len(examples) * _HEIGHT)
    ratios = (_ASPECT, *(1.0 for _ in range(columns)))
    panels = figure.subplots(len(examples), columns + 1, squeeze=False, width_ratios=ratios)
    for line, (photo, scenes) in zip(panels, examples, strict=True):
        line[0].imshow(small_pixels(photo), aspect="auto", interpolation="antialiased")
        line[0].set(xticks=[], yticks=[])
        for panel, scene in zip(line[1:], scenes, strict=False):
            plot_scene(scene, ax=panel)
            panel.set(xlabel="", ylabel="", xticklabels=[], yticklabels=[])
    for panel, title in zip(panels[0], ("picture", "true scene", *("sample",) * columns), strict=False):
        panel.set_title(title, fontsize=7)
    for dpi in (110, 95, 80, 65, 50):
        buffer = io.BytesIO()
        figure.savefig(buffer, dpi=dpi, format="png")
        drawn = Image.open(buffer).convert("RGB")
        for quality in (80, 65, 50):
            encoded = io.BytesIO()
            drawn.save(encoded, "JPEG", quality=quality, optimize=True)
            if encoded.tell() <= MAX_BYTES:
                path.parent.mkdir(parents=True, exist_ok=True)
                with whole_file(path) as file:
                    file.write(encoded.getvalue())
                return
    raise ValueError(f"{path}: {len(examples)} examples do not fit {MAX_BYTES} bytes")
