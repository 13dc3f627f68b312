"""The evaluation from config to report: methods, measurements, tables, pictures."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import subprocess
import time
from pathlib import Path
from typing import Any

from scjax.evaluate import tables
from scjax.evaluate.generated import ModelFunctions, OtherShardsPending, SamplingOptions, weights_hash
from scjax.evaluate.latent import latent_section
from scjax.evaluate.method_spec import MethodSpec, parse_methods
from scjax.evaluate.methods import MethodBuilder
from scjax.evaluate.novelty import diversity_section, novelty_section, with_stored_scenes
from scjax.evaluate.page import write_report
from scjax.evaluate.pictures import draw_pictures
from scjax.evaluate.population import Population, measure_populations
from scjax.evaluate.reconstruction import reconstruction_section
from scjax.evaluate.sources import open_source
from scjax.metrics.scene_stats import SceneStats
from scjax.scene.per_type import PerType

REAL, RETRIEVAL_SET = "real", "retrieval set"
MAX_CONTROL_DRAWS = 200  # bootstrap samples of control, which are costly


@dataclasses.dataclass(frozen=True)
class Measured:
    """All populations of an evaluation with their statistics.

    Attributes:
      methods: title -> population.
      stats: title -> statistics of its scenes.
      real: statistics of the references.
      retrieval_set: statistics of the retrieval set; None without one.
    """

    methods: dict[str, Population]
    stats: dict[str, SceneStats]
    real: SceneStats
    retrieval_set: SceneStats | None


def run_evaluation(config: Any, workdir: Path, functions: ModelFunctions | None = None) -> Path | None:
    """The whole evaluation; returns the path of report.html, or None if other shards have not finished.

    Args:
      config: of ``scjax.evaluate.config``.
      workdir: folder for generated scenes, measured parts and the report.
      functions: of scjax.generate; tests pass their own.

    Raises:
      ValueError: the config is inconsistent, or a file does not fit.
    """
    begin = time.perf_counter()
    workdir.mkdir(parents=True, exist_ok=True)
    (workdir / "config.json").write_text(json.dumps(json.loads(config.to_json()), indent=1))
    builder = _builder(config, workdir, functions or ModelFunctions())
    specs = method_specs(config)
    methods = _populations(builder, specs)
    measured = None if methods is None else _measured(builder, methods, config, workdir)
    if measured is None:
        return None
    sections = _sections(config, builder, measured)
    pictures = {}
    if config.pictures:
        pictures = draw_pictures(
            workdir / "pictures",
            measured.real,
            measured.stats,
            measured.methods,
            side_by_side=config.side_by_side,
            gallery=config.gallery,
        )
    facts = _facts(config, builder, specs, measured)
    write_report(workdir, config.title, {**facts, "took": f"{time.perf_counter() - begin:.0f} s"}, sections, pictures)
    return workdir / "report.html"


def method_specs(config: Any) -> list[MethodSpec]:
    """The methods of a config, with their folders.

    Raises:
      ValueError: an entry describes no method, a folder is not given, or names are not unique.
    """
    folders = {**config.folders.to_dict(), "model": config.model}
    specs = [spec.with_folders(folders) for spec in parse_methods(config.methods, config.more)]
    if not specs:
        raise ValueError("there is nothing to compare: give --config.methods or --config.more")
    names = [spec.title for spec in specs]
    if len(set(names)) < len(names) or {REAL, RETRIEVAL_SET} & set(names):
        raise ValueError(f"methods need unique names other than {REAL} and {RETRIEVAL_SET}: {', '.join(names)}")
    return specs


def _builder(config: Any, workdir: Path, functions: ModelFunctions) -> MethodBuilder:
    reference = open_source(config.reference)
    if not reference.clusters:
        raise ValueError(f"{config.reference} holds no scenes")
    if any(config.temperature) and not all(config.temperature):
        raise ValueError(
            f"--config.temperature must be two numbers above 0, of agents and of lanes, not {config.temperature}"
        )
    agents, lanes = config.temperature
    return MethodBuilder(
        reference,
        open_source(config.retrieval_set) if config.retrieval_set else None,
        count=config.num_scenes or len(reference.clusters),
        folder=workdir / "scenes",
        options=SamplingOptions(
            seed=config.seed,
            num_steps=config.num_steps or None,
            guidance=config.guidance or None,
            temperature=PerType(agents=agents, lanes=lanes) if agents else None,
        ),
        consensus=max(config.consensus, 1),
        field_of_view=tuple(config.field_of_view) if config.field_of_view[0] else None,
        attributes=config.attributes,
        shard=tuple(config.shard),
        part_size=config.part_size,
        functions=functions,
    )


def _populations(builder: MethodBuilder, specs: list[MethodSpec]) -> dict[str, Population] | None:
    """All methods by title; None where other shards have to generate scenes first."""
    methods: dict[str, Population] = {}
    for spec in specs:
        with contextlib.suppress(OtherShardsPending):
            methods[spec.title] = builder.population(spec)
    return methods if len(methods) == len(specs) else None


def _measured(builder: MethodBuilder, methods: dict[str, Population], config: Any, workdir: Path) -> Measured | None:
    """Measures all populations; None where other shards have to measure parts first."""
    populations = {REAL: Population(REAL, builder.reference)}
    if builder.retrieval_set is not None:
        populations[RETRIEVAL_SET] = Population(RETRIEVAL_SET, builder.retrieval_set)
    populations |= methods
    results = measure_populations(
        list(populations.values()),
        workdir / "measured",
        workers=config.workers,
        shard=tuple(config.shard),
        part_size=config.part_size,
    )
    if results is None:
        return None
    stats = dict(zip(populations, results, strict=True))
    return Measured(methods, {name: stats[name] for name in methods}, stats[REAL], stats.get(RETRIEVAL_SET))


def _sections(config: Any, builder: MethodBuilder, measured: Measured) -> list[tables.Section]:
    """The tables that have rows."""
    stats, real, methods = measured.stats, measured.real, measured.methods
    draws, seed = config.bootstrap, config.seed
    control_options = {"seed": seed, "draws": min(draws, MAX_CONTROL_DRAWS)}
    rows = {name: population.rows for name, population in methods.items()}
    sections = [
        tables.distribution_section(stats, real, measured.retrieval_set, mode, draws=draws)
        for mode in (("strict", "compat") if config.compat else ("strict",))
    ]
    sections.append(tables.realism_section({REAL: real, **stats}, draws=draws))
    sections.append(tables.match_section(stats, draws=draws))
    sections.append(tables.control_section(stats, real, rows, **control_options))
    sections.append(tables.gain_section(stats, real, rows, config.gains, **control_options))
    if config.attributes:
        sections.append(tables.attribute_section(stats, draws=draws))
    sections.append(tables.count_section(stats, real, rows))
    if config.novelty and builder.retrieval_set is not None:
        novel = with_stored_scenes({**methods, REAL: Population(REAL, builder.reference)})
        sections.append(novelty_section(novel, builder.retrieval_set, config.novelty))
    sections.append(diversity_section(list(methods.values()), config.novelty or len(real)))
    sections.append(reconstruction_section(methods, builder.models))
    if config.latent_model:
        model = builder.model(config.latent_model.replace("{model}", config.model))
        sections.append(latent_section(methods, builder.reference, builder.retrieval_set, model, **control_options))
    return [section for section in sections if section.rows]


def _facts(config: Any, builder: MethodBuilder, specs: list[MethodSpec], measured: Measured) -> dict[str, str]:
    """The head of the report: what the numbers were computed from."""
    real, retrieval_set = measured.real, builder.retrieval_set
    facts = {
        "references": f"{config.reference}: {len(real)} scenes at {len(set(real.clusters))} locations, "
        f"{builder.reference.fingerprint}",
        "retrieval set": "none"
        if retrieval_set is None
        else f"{config.retrieval_set}: {len(retrieval_set.clusters)} scenes, {retrieval_set.fingerprint}",
        "models": "; ".join(f"{folder}: {weights_hash(model)}" for folder, model in builder.models.items()) or "none",
        "methods": f"{builder.count} scenes each unless stated; seed {config.seed}",
        "code": _commit(),
    }
    if selected := [spec.title for spec in specs if spec.best_of > 1]:
        facts["selection"] = (
            f"{', '.join(selected)}: the best of several samples by their attributes, repaired. "
            "These rows do not measure the quality of a model."
        )
    return facts


def _commit() -> str:
    """The git commit of the code, and the number of changed files."""
    root = Path(__file__).resolve().parents[2]
    try:
        head, status = (
            subprocess.run(["git", *command], cwd=root, capture_output=True, text=True, check=True).stdout.strip()
            for command in (("rev-parse", "HEAD"), ("status", "--porcelain"))
        )
    except (OSError, subprocess.CalledProcessError):
        return "outside a git checkout"
    changed = len(status.splitlines())
    return head + (f", {changed} changed files" if changed else "")
