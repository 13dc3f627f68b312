"""``scjax data``: training records from recorded or synthetic scenes, what is added to them, and their scenes as files.

The same commands run as ``python -m scjax.data``. One command a file.
"""

from __future__ import annotations

from collections.abc import Sequence

import click

from scjax.cli.data.attributes import data_attributes
from scjax.cli.data.build import data_build
from scjax.cli.data.caption import data_caption
from scjax.cli.data.dashcam import data_dashcam
from scjax.cli.data.embed import data_embed
from scjax.cli.data.embed_images import data_embed_images
from scjax.cli.data.logs import data_logs
from scjax.cli.data.scenes import data_scenes
from scjax.cli.data.synthetic import data_synthetic
from scjax.cli.data.towns import data_towns


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    no_args_is_help=True,
)
def data() -> None:
    """Prepares training records from recorded or synthetic scenes.

    All trainings need records: build, synthetic or towns. One on text also needs caption, then embed; one on attributes
    needs attributes. dashcam renders pictures of synthetic records, embed-images turns pictures into features. scenes
    writes what records hold as files, logs the motion of synthetic worlds and towns.

    Exit codes: 0 done; 1 refused (one line on stderr says why); 2 wrong usage; 3 records were built, but some files
    or pictures were skipped (listed on stderr and in manifest.json or images.json); 130 interrupted.
    """


for command in (
    data_build,
    data_synthetic,
    data_towns,
    data_caption,
    data_embed,
    data_embed_images,
    data_dashcam,
    data_attributes,
    data_scenes,
    data_logs,
):
    data.add_command(command)


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
