"""``scjax data``: training records from recorded or synthetic scenes, their captions, and features of the captions.

The same commands run as ``python -m scjax.data``.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import click

from scjax.cli.data_command import DataCommand, workers_option
from scjax.cli.data_towns import data_towns
from scjax.data.build_options import BuildOptions, PoseOptions

_CONTINUE = "run the same command again to continue"
_NOTHING_WRITTEN = "nothing was written for the split in progress"
_SOME_SKIPPED = 3  # exit code


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    no_args_is_help=True,
)
def data() -> None:
    """Prepares training records from recorded or synthetic scenes.

    Training on text needs records (build or synthetic), then caption, then embed.

    Exit codes: 0 done; 1 refused (one line on stderr says why); 2 wrong usage; 3 records were built, but some files
    were skipped (listed on stderr and in manifest.json); 130 interrupted.
    """


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


@data.command("build", short_help="Recorded scenes -> training records.", cls=DataCommand, interrupted=_CONTINUE)
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
    """Cuts training records out of recorded scenes.

    SCENES is searched for *.json.gz files of schema scene-json-1; folders named peer_outputs or images* are left out.
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


@data.command(
    "synthetic",
    short_help="A synthetic world -> training records; needs no data set.",
    cls=DataCommand,
    interrupted=_CONTINUE,
)
@click.argument("out", metavar="RECORDS")
@click.option("--worlds", type=int, default=1000, metavar="N", show_default=True, help="Number of worlds.")
@click.option("--seed", type=int, default=0, metavar="S", show_default=True, help="World k depends on S and k alone.")
@click.option(
    "--ordinary",
    type=float,
    default=1.0,
    metavar="SHARE",
    show_default=True,
    help="Share of scenes without an event, a roundabout, a bend or a yellow light that is kept. A smaller share makes "
    "those frequent.",
)
@click.option(
    "--events",
    multiple=True,
    metavar="EVENT...",
    help='Show one of these, as "double parking", in every world that has a place for it. An event named twice comes '
    "twice as often; an unknown one is answered with the list of all. [default: any, in some worlds]",
)
@workers_option
@click.option(
    "--split-percent",
    type=float,
    default=5.0,
    metavar="P",
    show_default=True,
    help="Share of worlds held out as the val split.",
)
def data_synthetic(
    out: str, worlds: int, seed: int, ordinary: float, events: tuple[str, ...], workers: int, split_percent: float
) -> int:
    """Makes training records of a synthetic world: streets, motorways, traffic, people and rare events.

    No data set is needed. Every world is a location of its own and gives up to 15 records. RECORDS receives shards and
    manifest.json as from build, and labels (train-labels.jsonl.gz) of what each scene shows.
    """
    from scjax.data.build import build_records
    from scjax.synthetic.source import Worlds

    options = BuildOptions(split_percent=split_percent, files_per_shard=64)
    manifest = build_records(Worlds(seed, worlds, ordinary, events), out, options, workers=workers)
    for split, entry in manifest["splits"].items():
        click.echo(f"{split}: {entry['records']} records of {entry['scenes']} worlds")
    return 0


@data.command(
    "caption", short_help="Facts and sentences for every record.", cls=DataCommand, interrupted=_NOTHING_WRITTEN
)
@click.argument("records", metavar="RECORDS")
@workers_option
@click.option(
    "--paraphrases", type=int, default=2, metavar="N", show_default=True, help="Texts of each style per record."
)
@click.option(
    "--drop",
    type=float,
    default=0.3,
    metavar="P",
    show_default=True,
    help="Share of the facts that a text leaves out, as people do; 0 writes all facts that its style has words for.",
)
@click.option("--seed", type=int, default=0, metavar="S", show_default=True, help="Seed of the choice of words.")
def data_caption(records: str, workers: int, paraphrases: int, drop: float, seed: int) -> int:
    """Describes every record: facts read off lanes and agents by rule, and sentences made from the facts.

    RECORDS receives captions-train.jsonl.gz and captions-val.jsonl.gz, one line per record in record order. Texts come
    in three styles: one or two short sentences; "ROAD & CONTROL: ... AGENTS: ..."; a paragraph.
    """
    from scjax.data.captions import add_captions

    counts = add_captions(records, paraphrases=paraphrases, drop=drop, seed=seed, workers=workers)
    for split, count in counts.items():
        click.echo(f"{split}: {count} records captioned")
    return 0


@data.command(
    "embed",
    short_help="Token features of the captions, for training on text.",
    cls=DataCommand,
    interrupted=_NOTHING_WRITTEN,
)
@click.argument("records", metavar="RECORDS")
@click.option("--encoder", metavar="DIR", help="Folder of a text encoder (BERT, T5 or UMT5, Hugging Face layout).")
@click.option("--split", type=click.Choice(["train", "val"]), help="Only this split: val is enough to judge a model.")
def data_embed(records: str, encoder: str | None, split: str | None) -> int:
    """Encodes the captions of records with a frozen text encoder, once, for training on text.

    RECORDS receives text-train.npz and text-train.bin, and the same of val. Without --encoder, all-MiniLM-L6-v2 is
    found or fetched.
    """
    from scjax.data.caption_features import embed_captions
    from scjax.encoders.text import load_text_encoder

    splits = (split,) if split else ("train", "val")
    unchanged: list[str] = []
    counts = embed_captions(records, load_text_encoder(encoder), splits=splits, on_unchanged=unchanged.append)
    for name, count in counts.items():
        state = "are embedded already, nothing to do" if name in unchanged else "embedded"
        click.echo(f"{name}: {count} different texts {state}")
    return 0


data.add_command(data_towns)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs ``python -m scjax.data`` and returns its exit code (see --help)."""
    try:
        code = data.main(argv, prog_name="python -m scjax.data", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except click.Abort:
        return 130
    except Exception as error:  # a fault of scjax itself: one line, as for all others
        words = " ".join(str(error).split())
        click.echo(f"error: {type(error).__name__}: {words}: please report this command as a fault of scjax", err=True)
        return 1
    return code if isinstance(code, int) else 0
