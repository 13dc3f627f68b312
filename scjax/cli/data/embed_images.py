"""scjax data embed-images: features and depth of a folder of pictures."""

from __future__ import annotations

from pathlib import Path

import click

from scjax.cli.data.command import CONTINUE, DataCommand

_SOME_SKIPPED = 3  # exit code


@click.command(
    "embed-images",
    short_help="Features and depth of pictures, for training on images.",
    cls=DataCommand,
    interrupted=CONTINUE,
)
@click.argument("images", metavar="IMAGES")
@click.argument("out", metavar="OUT")
@click.option(
    "--encoder",
    metavar="DIR",
    help="Folder of a DINOv2 or DINOv3 (Hugging Face layout), or its name in the Hugging Face cache. "
    "[default: the network that ships, for rendered pictures]",
)
@click.option(
    "--depth",
    metavar="DIR",
    help="Folder of a Depth Anything, its name in the Hugging Face cache, or a folder of depth files (.npy, .npz, "
    "16-bit .png) with the names of the pictures. Without it there is no depth.",
)
@click.option(
    "--camera",
    metavar="NAME|FILE",
    help="Camera that took all pictures, as of scjax render, for the network that ships: it reads standard views. "
    "[default: they are standard views, as of scjax data dashcam]",
)
@click.option("--inverse-depth", is_flag=True, help="The depth files hold inverse depth.")
@click.option(
    "--depth-size", type=int, default=518, metavar="N", show_default=True, help="Shorter side for the depth network."
)
@click.option(
    "--preprocessing",
    type=click.Choice(["squash", "letterbox", "wide"]),
    default="squash",
    show_default=True,
    help="14 x 14 cells, squashed or with borders, or 14 x 25 cells.",
)
@click.option(
    "--compute",
    type=click.Choice(["float32", "bfloat16", "auto"]),
    default="float32",
    show_default=True,
    help="Precision of products with the weights.",
)
def data_embed_images(
    images: str,
    out: str,
    encoder: str | None,
    depth: str | None,
    camera: str | None,
    inverse_depth: bool,
    depth_size: int,
    preprocessing: str,
    compute: str,
) -> int:
    """Encodes the pictures of a folder with frozen networks, once, for training on images.

    IMAGES is searched with its folders. OUT receives a file for each picture and its depth, and images.json, the list.
    The network that ships has seen rendered pictures alone. For photographs bring your own: docs/images.md names
    networks and their licenses.

    An interrupted run continues when the same command is run again. Pictures that cannot be read are left out, listed,
    and make the exit code 3.

    Example: scjax data embed-images pictures features --encoder facebook/dinov2-small
    """
    from scjax.cli.cameras import camera_ahead
    from scjax.data.image_features import embed_images
    from scjax.encoders.base import CONFIG_FILE
    from scjax.encoders.dashcam_weights import takes_standard_views
    from scjax.encoders.depth import load_depth_network
    from scjax.encoders.depth_files import FileDepth
    from scjax.encoders.preprocessing import PREPROCESSINGS
    from scjax.encoders.vision import load_image_encoder
    from scjax.generate.picture_networks import EMBEDDED_VISION

    provider = None
    if depth is not None:
        folder = Path(depth)
        if folder.is_dir() and not (folder / CONFIG_FILE).is_file() and not (folder / "snapshots").is_dir():
            provider = FileDepth(folder, root=images, is_inverse=inverse_depth)
        else:
            provider = load_depth_network(depth, shorter_side=depth_size, compute=compute)  # pyright: ignore
    elif inverse_depth:
        raise ValueError("--inverse-depth is given without --depth: give the folder of the depth files")
    loaded = load_image_encoder(encoder or EMBEDDED_VISION, compute=compute)  # pyright: ignore[reportArgumentType]
    if camera is not None and (provider is not None or not takes_standard_views(loaded.name)):
        raise ValueError("--camera is for the network that ships, without --depth: leave out one of them")
    mounted = None if camera is None else camera_ahead(camera)
    report = embed_images(images, out, loaded, PREPROCESSINGS[preprocessing], depth=provider, camera=mounted)
    click.echo(f"{report.computed} pictures embedded, {report.reused} were already")
    if provider is not None and report.without_depth:
        click.echo(f"{report.without_depth} pictures have no depth in {depth}", err=True)
    for skipped in report.skipped:
        click.echo(f"skipped {skipped.file}: {skipped.reason}", err=True)
    return _SOME_SKIPPED if report.skipped else 0
