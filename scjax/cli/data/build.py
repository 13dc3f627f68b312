"""scjax data build: training records from recorded scenes."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from typing import Any

import click

from scjax.cli.data.command import CONTINUE, DataCommand, workers_option
from scjax.data.build_options import BuildOptions, PoseOptions

_SOME_SKIPPED = 3  # exit code


def _pose_options(prefix: str, poses: str, defaults: PoseOptions) -> Callable[[Callable], Callable]:
    """The four options of ``PoseOptions``, with ``prefix`` before their names."""
    helps = {
        "spacing": (float, "M", f"Meters between {poses} of a scene, over all steps."),
        "max_poses": (int, "N", f"Most {poses} per scene, standard ones included."),
        "recorder_stride": (int, "N", f"Steps between {poses} of the recording car."),
        "other_stride": (int, "N", f"Steps between {poses} of other vehicles."),
    }

    def add(function: Callable) -> Callable:
        for name, (value_type, metavar, text) in reversed(helps.items()):
            function = click.option(
                f"--{prefix}{name.replace('_', '-')}",
                type=value_type,
                default=getattr(defaults, name),
                metavar=metavar,
                show_default=True,
                help=text,
            )(function)
        return function

    return add


@click.command("build", short_help="Recorded scenes -> training records.", cls=DataCommand, interrupted=CONTINUE)
@click.argument("source", metavar="SCENES")
@click.argument("out", metavar="RECORDS")
@workers_option
@click.option(
    "--split-percent",
    type=float,
    default=BuildOptions.split_percent,
    metavar="P",
    show_default=True,
    help="Share of locations held out as the val split. Which ones depends on their names only.",
)
@click.option("--limit", type=int, metavar="N", help="Use only the first N files, to try things out.")
@click.option(
    "--files-per-shard",
    type=int,
    default=BuildOptions.files_per_shard,
    metavar="N",
    show_default=True,
    help="Source files per shard.",
)
@click.option(
    "--join-distance",
    type=float,
    default=BuildOptions.join_distance,
    metavar="M",
    show_default=True,
    help="Lanes are connected across gaps up to this, in files that do not list connections; at most 1.",
)
@click.option(
    "--lane-poses",
    type=click.IntRange(0, 1000),
    default=BuildOptions.lane_poses,
    metavar="N",
    show_default=True,
    help="Poses along the lanes of maps without a vehicle; 0 leaves such maps out.",
)
@click.option("--no-resume", is_flag=True, help="Rebuild finished shards too.")
@click.option("--strict", is_flag=True, help="Stop at the first file that cannot be used or looks wrong.")
@_pose_options("", "standard poses", BuildOptions.poses)
@_pose_options("train-", "training poses", BuildOptions.train_poses)
def data_build(
    source: str, out: str, workers: int, limit: int | None, no_resume: bool, strict: bool, **options: Any
) -> int:
    """Cuts training records out of recorded scenes or maps.

    SCENES is one file, or a folder that is searched for *.json.gz files of schema scene-json-1, without folders named
    peer_outputs or images*; else for *.xodr (OpenDRIVE), *.xml (CommonRoad), *.osm (Lanelet2), *.pkl (ScenarioNet) or
    log_map_archive_*.json (Argoverse 2). The first that are found are used. Maps without a vehicle need --lane-poses.
    RECORDS receives ArrayRecord shards train-*.arrayrecord and val-*.arrayrecord, an index of each split
    (train-index.npz, val-index.npz) and, last of all, manifest.json. A record holds everything within 80 m of one ego
    pose; crop and pose jitter are chosen when it is read.

    val records are cut at the standard poses, those of the evaluation rule; the table of counts is made from them too.
    train records have denser training poses on top.

    An interrupted build continues when the same command is run again: finished shards are kept as long as their
    source files and the options are the same.

    Example: scjax data build recordings records --workers 2
    """
    from scjax.data.build import build_records

    names = [field.name for field in dataclasses.fields(PoseOptions)]
    build_options = BuildOptions(
        split_percent=options["split_percent"],
        files_per_shard=options["files_per_shard"],
        join_distance=options["join_distance"],
        lane_poses=options["lane_poses"],
        poses=PoseOptions(**{name: options[name] for name in names}),
        train_poses=PoseOptions(**{name: options[f"train_{name}"] for name in names}),
    )
    manifest = build_records(
        source, out, build_options, workers=workers, limit=limit, resume=not no_resume, strict=strict
    )
    for split, entry in manifest["splits"].items():
        locations = len(entry["clusters"])
        click.echo(f"{split}: {entry['records']} records of {entry['scenes']} scenes at {locations} locations")
    cleaned = manifest["cleaned"]
    click.echo(f"clipped {cleaned.get('speed', 0)} speeds, filled {cleaned.get('size', 0)} impossible sizes")
    if manifest["without_poses"]:
        click.echo(f"{len(manifest['without_poses'])} scenes have no vehicle to take as ego (--lane-poses N uses them)")
    _show_findings(manifest)
    for entry in manifest["skipped"]:
        click.echo(f"skipped {entry['file']}: {entry['reason']}", err=True)
    return _SOME_SKIPPED if manifest["skipped"] else 0


def _show_findings(manifest: dict[str, Any], most: int = 10) -> None:
    """What was noticed in the files, most frequent first; manifest.json names the files."""
    for name, label in (("warnings", "warning: "), ("notes", "")):
        counts, files = Counter(), Counter()
        for entry in manifest[name]:
            counts.update(entry["found"])
            files.update(entry["found"].keys())
        for text, count in counts.most_common(most):
            click.echo(f"{label}{text}: {count} in {files[text]} files", err=True)
        if len(counts) > most:
            click.echo(f"{label}{len(counts) - most} more kinds: see manifest.json", err=True)
