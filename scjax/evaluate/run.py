"""The evaluation from config to report: rows, their measures, tables, pictures."""

from __future__ import annotations

import contextlib
import json
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path

from scjax.evaluate import page, pictures, tables
from scjax.evaluate.generated import Pending, Sampling, weights_hash
from scjax.evaluate.latent import latent_section
from scjax.evaluate.methods import Rows
from scjax.evaluate.novelty import diversity_section, novelty_section, of_interest
from scjax.evaluate.population import Population, measured
from scjax.evaluate.reconstruction import reconstruction_section
from scjax.evaluate.sources import open_source
from scjax.metrics.scene_stats import SceneStats
from scjax.scene.per_type import PerType

SHOWN = 4  # rows that are drawn beside each other


def evaluate(config, workdir: Path) -> Path | None:
    """The whole evaluation, top to bottom; None if other shards have not done their parts yet."""
    begin = time.perf_counter()
    workdir.mkdir(parents=True, exist_ok=True)
    (workdir / "config.json").write_text(json.dumps(json.loads(config.to_json()), indent=1))

    # --- what is compared
    reference = open_source(config.reference)
    bank = open_source(config.bank) if config.bank else None
    if not reference.clusters:
        raise ValueError(f"{config.reference} holds no scenes")
    if any(config.temperature) and not all(config.temperature):
        raise ValueError(
            f"--config.temperature must be two numbers above 0, of agents and of lanes, not {config.temperature}"
        )
    temperature = (
        PerType(agents=config.temperature[0], lanes=config.temperature[1]) if any(config.temperature) else None
    )
    builder = Rows(
        reference,
        bank,
        config.samples or len(reference.clusters),
        workdir / "scenes",
        Sampling(config.seed, config.steps or None, config.guidance or None, temperature),
        consensus=max(config.consensus, 1),
        wedge=tuple(config.wedge) if config.wedge[0] else None,
        facts=config.facts,
        shard=tuple(config.shard),
    )
    texts = [named(text, config) for text in (*config.rows, *config.more) if text]
    if not texts:
        raise ValueError("there is nothing to compare: give --config.rows or --config.more")
    made: list[Population] = []
    for text in texts:
        with contextlib.suppress(Pending):
            made.append(builder.population(text))
    if len(made) < len(texts):
        return None
    rows = {one.name: one for one in made}
    if len(rows) < len(made) or rows.keys() & {"real", "bank"}:
        raise ValueError(f"rows need names of their own, not real or bank: {', '.join(one.name for one in made)}")
    extra = {"real": Population("real", reference)}
    if bank is not None:
        extra["bank"] = Population("bank", bank)

    # --- measured once, part by part
    every = {**extra, **rows}
    found = measured(list(every.values()), workdir / "measured", workers=config.workers, shard=tuple(config.shard))
    if found is None:
        return None
    by_name = dict(zip(every, found, strict=True))
    real, ours = by_name["real"], {name: by_name[name] for name in rows}

    # --- tables
    modes = ("strict", "compat") if config.compat else ("strict",)
    turns = {name: one.rows for name, one in rows.items()}
    sections: list[tables.Section | None] = [
        tables.distribution_section(ours, real, by_name.get("bank"), mode, draws=config.draws) for mode in modes
    ]
    sections.append(tables.fault_section({"real": real, **ours}, draws=config.draws))
    sections.append(tables.match_section(ours, draws=config.draws))
    pairs, draws = tuple(config.gains), min(config.draws, 200)
    sections.append(tables.control_section(ours, real, turns, seed=config.seed, draws=draws))
    sections.append(tables.gain_section(ours, real, turns, pairs, seed=config.seed, draws=draws))
    if config.facts:
        sections.append(tables.caption_section(ours, draws=config.draws))
    sections.append(tables.count_section(ours, real, turns))
    if config.novelty and bank is not None:
        chosen = of_interest({**rows, "real": extra["real"]})
        sections.append(novelty_section(chosen, bank, config.novelty))
    sections.append(diversity_section(list(rows.values()), config.novelty or len(real)))
    sections.append(reconstruction_section(rows, builder.models))
    if config.latent:
        judge = builder.model(config.latent if config.latent != "MODEL" else config.model)
        sections.append(latent_section(rows, reference, bank, judge, seed=config.seed, draws=min(config.draws, 200)))
    shown = [section for section in sections if section is not None and section.rows]

    # --- the report
    facts = {
        "references": f"{config.reference}: {len(real)} scenes at {len(set(real.clusters))} locations, "
        f"{reference.fingerprint}",
        "bank": f"{config.bank}: {len(bank.clusters)} scenes, {bank.fingerprint}" if bank is not None else "none",
        "models": "; ".join(f"{folder}: {weights_hash(model)}" for folder, model in builder.models.items()) or "none",
        "rows": f"{builder.count} scenes each unless stated; seed {config.seed}",
        "code": _commit(),
        "took": f"{time.perf_counter() - begin:.0f} s in this call",
    }
    page.write(workdir, config.title, facts, shown, draw(workdir, real, ours, rows))
    return workdir / "report.html"


def named(text: str, config) -> str:
    """A row's text with the folders that its capitals stand for.

    Raises:
      ValueError: if one stands for nothing.
    """
    known = dict(entry.partition("=")[::2] for entry in config.scenes if entry)
    if config.model:
        known["MODEL"] = config.model
    head, mark, rest = text.partition(":")
    word = rest.split("#")[0].split("?")[0]
    if not mark or not word.isupper():
        return text
    if word not in known:
        cure = "--config.model=FOLDER" if word == "MODEL" else f"--config.scenes=\"('{word}=FOLDER',)\""
        raise ValueError(f"row {text!r}: {word} stands for no folder: give {cure}, or rows of your own (--config.rows)")
    return f"{head}:{known[word]}{rest[len(word) :]}"


def draw(
    workdir: Path, real: SceneStats, ours: Mapping[str, SceneStats], rows: Mapping[str, Population]
) -> dict[str, Path]:
    """Distributions of the first rows, and galleries of the first."""
    folder = workdir / "pictures"
    folder.mkdir(exist_ok=True)
    drawn = {"Distributions of vehicles": folder / "distributions.png"}
    pictures.distributions(real, {name: ours[name] for name in list(ours)[:SHOWN]}, drawn["Distributions of vehicles"])
    answering = [one for one in rows.values() if one.references is not None][:SHOWN]
    if answering:
        drawn["Side by side"] = folder / "side-by-side.png"
        pictures.side_by_side(answering, drawn["Side by side"])
    name = next(iter(rows))
    for value in pictures.BETTER:
        path = folder / f"gallery-{value}.png"
        if pictures.gallery(rows[name], ours[name], value, path):
            drawn[f"{name}: best, median and worst by {value.replace('_', ' ')}"] = path
    return drawn


def _commit() -> str:
    """What the numbers were made with."""
    root = Path(__file__).resolve().parents[2]
    try:
        texts = [
            subprocess.run(["git", *command], cwd=root, capture_output=True, text=True, check=True).stdout.strip()
            for command in (("rev-parse", "HEAD"), ("status", "--porcelain"))
        ]
    except (OSError, subprocess.CalledProcessError):
        return "outside a git checkout"
    changed = len(texts[1].splitlines())
    return texts[0] + (f", {changed} files changed since" if changed else "")
