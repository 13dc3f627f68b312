"""The page of a trained policy: a table beside the baselines, and the curve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from experiments.studies.page import new_figure, table_lines, write_page
from scjax.scene.files import write_file

_PANELS = {"reward": "return", "progress": "progress [m]", "collides": "episodes with a collision"}
_COLUMNS = {
    "reward": ("return", 1.0, 1),
    "progress": ("progress, m", 1.0, 0),
    "collides": ("collision, %", 100.0, 0),
    "off_road": ("off the road, %", 100.0, 0),
    "runs_red": ("at red, %", 100.0, 0),
    "arrives": ("leaves the map, %", 100.0, 0),
}


def make_page(out: Path, command: str, curve: Sequence[Mapping], fixed: Mapping[str, Mapping], scenes: int) -> None:
    """Writes the page, its numbers and the picture of the curve."""
    rows = {"policy before training": curve[0], "policy after training": curve[-1], **fixed}
    table = [
        [name, *(f"{row[key] * scale:.{digits}f}" for key, (_, scale, digits) in _COLUMNS.items())]
        for name, row in rows.items()
    ]
    loads = [point["load"] for point in curve]
    minutes = sum(point["seconds"] for point in curve) / 60
    best, last = fixed["RoutePolicy"]["reward"], curve[-1]["reward"]
    verdict = "beats" if last > best else "does not beat"
    text = [
        "# A policy learns to drive",
        "",
        f"`{command}`",
        "",
        f"PPO of skrl in `DrivingVectorEnv`: {scenes} moments of synthetic worlds, {curve[-1]['steps']:,} steps of"
        f" 0.1 s in all. Training took {minutes:.0f} minutes on the clock, without the scores. The load of the two"
        f" cores was {min(loads):.0f} to {max(loads):.0f}.",
        "",
        f"Each row is the mean of {curve[-1]['episodes']} episodes of 12 s on {scenes} other worlds. The policy acts"
        f" without noise. Training changes the share of episodes off the road from {_percent(curve, 'off_road')} %, and"
        f" that with a collision from {_percent(curve, 'collides')} %. The policy {verdict} `RoutePolicy`, which"
        " follows the route by rules written by hand. Before training it hardly acts. `RewardWeights` has its defaults."
        " An episode ends with a collision, off the road or where the route leaves the map.",
        "",
        *table_lines(["driver", *(title for title, _, _ in _COLUMNS.values())], table),
        "",
    ]
    write_page(out, "\n".join(text), {"curve": list(curve), "baselines": dict(fixed)}, _figure(curve, fixed))
    _use_few_colors(out.with_name(f"{out.name}.png"))


def _use_few_colors(path: Path) -> None:
    """Writes a picture again with 32 colors: a third of the size."""
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(32, method=Image.Quantize.MAXCOVERAGE)
    write_file(path, lambda file: small.save(file, "PNG", optimize=True))


def _percent(curve: Sequence[Mapping], key: str) -> str:
    """The first and the last value of a share."""
    return f"{100 * curve[0][key]:.0f} to {100 * curve[-1][key]:.0f}"


def _figure(curve: Sequence[Mapping], fixed: Mapping[str, Mapping]) -> Figure:
    figure = new_figure(7.0, 2.0)
    for ax, (key, title) in zip(figure.subplots(1, len(_PANELS)), _PANELS.items(), strict=True):
        ax.plot(
            [point["steps"] / 1000 for point in curve], [point[key] for point in curve], color="#cf3b3b", label="policy"
        )
        for (name, row), style in zip(fixed.items(), ("-", "--", ":"), strict=True):
            ax.axhline(row[key], color="#3b4048", linestyle=style, linewidth=0.9, label=name)
        ax.set_title(title, fontsize=8)
        ax.tick_params(labelsize=7)
        ax.set_xlabel("thousand steps", fontsize=7)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=7)
    return figure
