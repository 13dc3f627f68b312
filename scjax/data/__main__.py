"""Command line of scjax.data: `python -m scjax.data build SOURCE OUT`."""

from __future__ import annotations

import argparse
import sys

DESCRIPTION = "Prepare recorded driving scenes for training."
BUILD = """\
Cut training records out of recorded scenes.

SOURCE is searched for *.json.gz files of schema scene-json-1 (folders named peer_outputs or images* are left
out). OUT receives ArrayRecord shards train-*.arrayrecord and val-*.arrayrecord, an index of the records of each
split (train-index.npz, val-index.npz) and, last of all, manifest.json. A record holds everything within 80 m of
one ego pose; windows, layouts and pose jitter are chosen when it is read.

A build that was interrupted continues where it stopped when the same command is run again: finished shards are
kept as long as their source files and the options are the same."""
CAPTION = """\
Describe every record: facts read off lanes and agents by rule, and sentences made from the facts.

RECORDS receives captions-train.jsonl.gz and captions-val.jsonl.gz, a line a record in record order, with texts in
three styles: one or two short sentences; "ROAD & CONTROL: ... AGENTS: ..."; a paragraph."""
SYNTHETIC = """\
Make training records of a synthetic world: streets, motorways, traffic, people, rare events. No data set is needed.

Every world is a location of its own and gives up to 15 records; OUT receives shards and manifest.json as from build,
and labels (train-labels.jsonl.gz): what is known of each scene because it was made."""
EMBED = """\
Encode the captions of records with a frozen text encoder, once, for training on text.

RECORDS receives text-train.npz and text-train.bin (and the same of val). Without --encoder it is all-MiniLM-L6-v2,
which is found or fetched."""
EPILOG = """\
exit codes: 0 all files used; 1 nothing built (bad arguments, no usable file, or a bad file under --strict);
2 wrong usage; 3 records built, but some files were skipped (listed above and in manifest.json); 130 interrupted.

example: python -m scjax.data build recordings records --workers 2"""


def parser() -> argparse.ArgumentParser:
    """The command's argument parser."""
    top = argparse.ArgumentParser(prog="python -m scjax.data", description=DESCRIPTION)
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, summary: str, description: str, epilog: str | None = None) -> argparse.ArgumentParser:
        return commands.add_parser(
            name, help=summary, description=description, epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip

    build = command("build", "recorded scenes -> training records", BUILD, EPILOG)
    build.add_argument("source", metavar="SOURCE", help="folder of recorded scenes (searched recursively)")
    build.add_argument("out", metavar="OUT", help="folder for the records; made if it is not there")
    add = build.add_argument
    add("--workers", type=int, default=2, metavar="N",
        help="worker processes; 0: work in this one (default %(default)s)")  # fmt: skip
    add("--split-percent", type=float, default=10.0, metavar="P",
        help="share of location clusters held back as the val split; which ones depends on their names only "
             "(default %(default)s)")  # fmt: skip
    add("--limit", type=int, metavar="N", help="use only the first N files, to try things out")
    add("--files-per-shard", type=int, default=16, metavar="N", help="source files a shard (default %(default)s)")
    add("--no-resume", action="store_true", help="rebuild finished shards too")
    add("--strict", action="store_true", help="stop at the first file that cannot be used instead of skipping it")
    standard = build.add_argument_group(
        "standard poses", "of the evaluation rule; val records are cut at these, the count table is made from these"
    )
    dense = build.add_argument_group("training poses", "that train records have on top of the standard ones")
    for group, prefix, defaults in ((standard, "", (16.0, 8, 10, 30)), (dense, "train-", (4.0, 40, 5, 30))):
        spacing, count, recorder, other = defaults
        group.add_argument(f"--{prefix}spacing", type=float, default=spacing, metavar="M",
                           help="metres between poses of a scene, over all steps (default %(default)s)")  # fmt: skip
        group.add_argument(f"--{prefix}max-poses", type=int, default=count, metavar="N",
                           help="poses a scene at most, standard ones included (default %(default)s)")  # fmt: skip
        group.add_argument(f"--{prefix}recorder-stride", type=int, default=recorder, metavar="N",
                           help="steps between poses of the recording car (default %(default)s)")  # fmt: skip
        group.add_argument(f"--{prefix}other-stride", type=int, default=other, metavar="N",
                           help="steps between poses of other vehicles (default %(default)s)")  # fmt: skip
    world = command("synthetic", "training records of a synthetic world", SYNTHETIC)
    world.add_argument("out", metavar="OUT", help="folder for the records; made if it is not there")
    world.add_argument("--worlds", type=int, default=1000, metavar="N", help="how many (default %(default)s)")
    world.add_argument("--seed", type=int, default=0, metavar="S",
                       help="world k depends on S and k alone (default %(default)s)")  # fmt: skip
    world.add_argument("--ordinary", type=float, default=1.0, metavar="SHARE",
                       help="share of scenes without an event, a roundabout, a bend or a yellow light that is kept; "
                            "less makes those frequent (default %(default)g: all)")  # fmt: skip
    world.add_argument("--events", nargs="+", default=[], metavar="EVENT",
                       help='stage one of these, as "double parking", in every world that has a place for it; told '
                            "twice it comes twice as often, and an unknown one is answered with all that there are "
                            "(default: any, in some worlds)")  # fmt: skip
    world.add_argument("--workers", type=int, default=2, metavar="N",
                       help="worker processes; 0: work in this one (default %(default)s)")  # fmt: skip
    world.add_argument("--split-percent", type=float, default=5.0, metavar="P",
                       help="share of worlds held back as the val split (default %(default)s)")  # fmt: skip
    text = command("embed", "token features of captions", EMBED)
    text.add_argument("records", metavar="RECORDS", help="folder with captions")
    text.add_argument("--encoder", metavar="DIR", help="folder of a text encoder (BERT, T5 or UMT5, Hugging Face)")
    text.add_argument("--split", choices=("train", "val"), help="only this one: val is enough to judge a model")
    said = command("caption", "facts and sentences for records", CAPTION)
    said.add_argument("records", metavar="RECORDS", help="folder made by the build command")
    said.add_argument("--workers", type=int, default=2, metavar="N",
                      help="worker processes; 0: work in this one (default %(default)s)")  # fmt: skip
    said.add_argument("--paraphrases", type=int, default=2, metavar="N",
                      help="texts of each style (default %(default)s)")  # fmt: skip
    said.add_argument("--drop", type=float, default=0.3, metavar="P",
                      help="share of the facts that a text leaves out, as people do; 0: it tells all that its style "
                           "has words for (default %(default)s)")  # fmt: skip
    said.add_argument("--seed", type=int, default=0, metavar="S", help="of the words (default %(default)s)")
    return top


def main(argv: list[str] | None = None) -> int:
    """Runs the command and returns its exit code (see --help)."""
    args = parser().parse_args(argv)
    run, interrupted = {
        "build": (_build, "run the same command again to continue"),
        "synthetic": (_synthetic, "run the same command again to continue"),
        "embed": (_embed, "nothing was written for the split under way"),
        "caption": (_caption, "nothing was written for the split under way"),
    }[args.command]
    try:
        return run(args)
    except ModuleNotFoundError as error:
        print(f"error: {error}: install the data extra, pip install 'scjax[data]'", file=sys.stderr)
        return 1
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"interrupted: {interrupted}", file=sys.stderr)
        return 130


def _build(args: argparse.Namespace) -> int:
    from scjax.data.build import build_records
    from scjax.data.build_options import BuildOptions, PoseOptions

    if args.workers < 0:
        raise ValueError(f"--workers is {args.workers}: it must be 0 or more")
    if args.limit is not None and args.limit < 1:
        raise ValueError(f"--limit is {args.limit}: it must be 1 or more")
    options = BuildOptions(
        split_percent=args.split_percent,
        files_per_shard=args.files_per_shard,
        poses=PoseOptions(
            spacing=args.spacing, max_poses=args.max_poses, recorder_stride=args.recorder_stride,
            other_stride=args.other_stride,
        ),
        train_poses=PoseOptions(
            spacing=args.train_spacing, max_poses=args.train_max_poses,
            recorder_stride=args.train_recorder_stride, other_stride=args.train_other_stride,
        ),
    )  # fmt: skip
    manifest = build_records(
        args.source, args.out, options, workers=args.workers, limit=args.limit, resume=not args.no_resume,
        strict=args.strict,
    )  # fmt: skip
    for split, entry in manifest["splits"].items():
        print(f"{split}: {entry['records']} records of {entry['scenes']} scenes at {len(entry['clusters'])} locations")
    cleaned = manifest["cleaned"]
    print(f"clipped {cleaned.get('speed', 0)} speeds, filled {cleaned.get('size', 0)} impossible sizes")
    if manifest["without_poses"]:
        print(f"{len(manifest['without_poses'])} scenes have no vehicle to take as ego: see manifest.json")
    for entry in manifest["skipped"]:
        print(f"skipped {entry['file']}: {entry['reason']}", file=sys.stderr)
    return 3 if manifest["skipped"] else 0


def _synthetic(args: argparse.Namespace) -> int:
    from scjax.data.build import build_records
    from scjax.data.build_options import BuildOptions
    from scjax.synthetic.source import Worlds

    if args.workers < 0:
        raise ValueError(f"--workers is {args.workers}: it must be 0 or more")
    options = BuildOptions(split_percent=args.split_percent, files_per_shard=64)
    manifest = build_records(
        Worlds(args.seed, args.worlds, args.ordinary, tuple(args.events)), args.out, options, workers=args.workers
    )
    for split, entry in manifest["splits"].items():
        print(f"{split}: {entry['records']} records of {entry['scenes']} worlds")
    return 0


def _embed(args: argparse.Namespace) -> int:
    from scjax.data.caption_features import embed_captions
    from scjax.encoders.text import load_text_encoder

    splits = (args.split,) if args.split else ("train", "val")
    for split, count in embed_captions(args.records, load_text_encoder(args.encoder), splits=splits).items():
        print(f"{split}: {count} different texts embedded")
    return 0


def _caption(args: argparse.Namespace) -> int:
    from scjax.data.captions import add_captions

    for split, count in add_captions(
        args.records, paraphrases=args.paraphrases, drop=args.drop, seed=args.seed, workers=args.workers
    ).items():
        print(f"{split}: {count} records captioned")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
