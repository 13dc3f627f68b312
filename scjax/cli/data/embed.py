"""scjax data embed: token features of the captions."""

from __future__ import annotations

import click

from scjax.cli.data.command import NOTHING_WRITTEN, DataCommand


@click.command(
    "embed",
    short_help="Token features of the captions, for training on text.",
    cls=DataCommand,
    interrupted=NOTHING_WRITTEN,
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
