"""The picture of a command: options, reading, and the view of a scene beside it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from scjax.cli.cameras import read_camera_option, rig_of_photo
from scjax.cli.output import slug

if TYPE_CHECKING:
    from scjax.camera import Rig
    from scjax.camera.photo import Photo
    from scjax.generate.components import Model
    from scjax.scene import Scene

_OPTIONS = (
    click.option(
        "--image",
        metavar="FILE",
        help="Picture of the road ahead that the scenes shall show, for models that read pictures. Beside each scene a "
        "file NAME-view.png shows both.",
    ),
    click.option(
        "--depth",
        metavar="FILE",
        help="Depth of the picture along the camera's axis: .npy or .npz [m], or 16-bit .png [1/256 m], 0 where it is "
        "unknown. [default: estimated, if the model has a network for it]",
    ),
    click.option(
        "--camera",
        metavar="NAME|FILE",
        help="Camera that took the picture, as of scjax render. Distances are read by it, and the scene is drawn into "
        "the picture, too. [default: the dashcam of scjax render]",
    ),
    click.option("--camera-name", metavar="NAME", help="Which camera, if --camera has several."),
)


def picture_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Adds --image and what belongs to it; ``read_picture`` takes their values."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


class PictureInput(NamedTuple):
    """A picture, its depth [m] or None, and a rig of the one camera that took it, or None."""

    photo: Photo
    depth: Any
    rig: Rig | None

    @property
    def name(self) -> str:
        """For files."""
        return slug(Path(self.photo.name).stem)

    def fields(self, model: Model) -> dict[str, Any]:
        """Fields of a condition, for a model that may read no cameras."""
        from scjax.encoders.dashcam_weights import takes_standard_views

        reads_camera = takes_standard_views(model.image_encoder)
        return {"image": self.photo, "depth": self.depth, "camera": self.rig if reads_camera else None}

    def write_view(self, scene: Scene, path: Path) -> None:
        """Writes the picture beside a scene."""
        from scjax.viz.photo_view import photo_view

        photo_view(self.photo, scene, self.rig, path=path)


def read_picture(
    image: str | None, depth: str | None = None, camera: str | None = None, camera_name: str | None = None
) -> PictureInput | None:
    """The picture that the options name; None without --image.

    Raises:
      UsageError: there are options without a picture.
      ValueError: a file is damaged or of another kind, the camera takes other pictures, or OpenCV is missing.
    """
    if camera_name is not None and camera is None:
        raise click.UsageError("--camera-name is given without --camera: give both, or leave it out")
    if image is None:
        for name, value in (("--depth", depth), ("--camera", camera)):
            if value is not None:
                raise click.UsageError(f"{name} is given without --image: give both, or leave it out")
        return None
    from scjax.camera.photo import read_photo

    photo = read_photo(image)
    meters = None
    if depth is not None:
        from scjax.encoders.depth_files import read_depth

        meters = read_depth(depth)
    return PictureInput(photo, meters, None if camera is None else _rig(camera, camera_name, photo))


def _rig(camera: str, name: str | None, photo: Photo) -> Rig:
    """The rig of the one camera that took a photo."""
    from scjax.camera.raster import require_opencv
    from scjax.generate.camera_stream import picture_camera

    require_opencv()
    calibration = read_camera_option(camera)
    rig = calibration.rig if name is None else calibration.rig.select(name)
    rig = rig_of_photo(calibration, rig, photo.name, "--camera-name")
    try:
        picture_camera(rig, photo.size)
    except ValueError as error:
        raise ValueError(f"--camera {camera}: {error}") from error
    return rig


def check_reads_pictures(model: Model) -> None:
    """Checks that a model reads pictures and that its encoder is here, before anything is computed.

    Raises:
      ValueError: one of both does not hold.
    """
    from scjax.generate.image_streams import model_preprocessing
    from scjax.generate.picture_networks import check_encoder, default_image_encoder

    model_preprocessing(model)
    check_encoder(default_image_encoder(model), model)
