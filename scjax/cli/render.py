"""scjax render: what cameras on a vehicle see of scenes, maps and recordings."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from scjax.cli.cameras import read_camera_option, rig_of_photo
from scjax.cli.export import log_of_content
from scjax.cli.output import say, writable_folder
from scjax.cli.plot import Place
from scjax.cli.scene_files import read_content

if TYPE_CHECKING:
    from scjax.camera import CameraCalibration, CameraPoses, Rig, WireframeRenderer, WireframeStyle
    from scjax.camera.dashcam import DashcamRenderer
    from scjax.scene import Log, Map, Scene

_PICTURES, _VIDEOS = (".png",), (".gif", ".mp4")


class PictureSize(click.ParamType):
    """Width and height of a picture: 1280x704."""

    name = "WxH"

    def convert(self, value, param, ctx) -> tuple[int, int]:
        """Two whole numbers; UsageError otherwise."""
        if isinstance(value, tuple):
            return value
        width, _, height = value.lower().partition("x")
        if not (width.isdecimal() and height.isdecimal() and 0 < int(width) <= 16384 and 0 < int(height) <= 16384):
            self.fail(f"{value!r} is no size: write pixels, as in 1280x704", param, ctx)
        return int(width), int(height)


@click.command("render")
@click.argument("file")
@click.option(
    "--camera",
    default="dashcam",
    show_default=True,
    metavar="NAME|FILE",
    help="Rig of cameras: one of those above, a rig file of scjax, or the calibration of a recorded moment.",
)
@click.option("--only", multiple=True, metavar="NAME", help="Camera of the rig; again for more. [default: all]")
@click.option(
    "--actor", type=click.IntRange(min=0), help="Index of the object that carries the rig. [default: the ego]"
)
@click.option("--at", type=Place(), help="A place that carries the rig instead, and where it looks (0: to +x).")
@click.option("--frame", "step", type=click.IntRange(min=0), help="Step of a recording. [default: the first]")
@click.option("--video", is_flag=True, help="All steps of a recording; --out is an .mp4 or .gif.")
@click.option("--scene", "number", type=click.IntRange(min=0), help="Scene of a file of several. [default: 0]")
@click.option("--photo", metavar="FILE", help="Photograph to draw on; with a calibration, from where it was taken.")
@click.option("--size", type=PictureSize(), help="Scale and cut the pictures to this size.")
@click.option("--palette", default="scjax", show_default=True, metavar="NAME", help="Colors: scjax, cosmos or sc.")
@click.option(
    "--occlusion/--no-occlusion", default=None, help="Boxes cover what is behind them. [default: not on --photo]"
)
@click.option(
    "--dashcam", "weather", metavar="WEATHER", help="Rendered pictures: clear, overcast, fog, rain, dusk, night or any."
)
@click.option("--seed", default=0, show_default=True, type=click.IntRange(min=0), help="Of the look of --dashcam.")
@click.option("--buffers", is_flag=True, help="Write depth, ids and kinds of the pixels of a picture too, as .npz.")
@click.option("--out", default="view.png", show_default=True, metavar="FILE", help="Picture (.png) or video to write.")
def render_command(
    file, camera, only, actor, at, step, video, number, photo, size, palette, occlusion, weather, seed, buffers, out
) -> None:
    """Draws what cameras on the ego, or on any other object, see of FILE: as wireframes, or rendered with --dashcam.

    FILE is anything that scjax plot draws. Lines are lanes, borders of the road, stop lines with the state of their
    signals, and boxes with a cross on their front. The names of all files go to stdout; FILE.cameras.json beside the
    pictures has the poses of the cameras.

    \b
    dashcam                           one camera, 1280 x 704 pixels, 64 degrees
    nuplan-front-a, nuplan-front-b    CAM_F0 of two cars of nuPlan, without distortion; with -raw as recorded
    waymo-front                       about the front camera of Waymo
    surround-6, surround-7            around the car; the seven have the names that photoreal renderers expect

    \b
    scjax render scene.json --out view.png
    scjax render log.npz --camera surround-7 --video --out drive.mp4
    scjax render log.npz --actor 3 --frame 20 --camera rig.json --buffers
    scjax render log.npz --camera sample.json --only CAM_FRONT --photo front.jpg
    scjax render log.npz --dashcam dusk --seed 3 --size 448x448

    Needs pip install 'scjax[camera]', and 'scjax[video]' for MP4 files.
    """
    if weather is not None and (photo is not None or occlusion is not None or palette != "scjax"):
        raise click.UsageError("--photo, --palette and --occlusion are for wireframes: leave --dashcam out")
    path = _checked_path(out, video, step, photo, buffers, actor, at)
    content = read_content(file)
    log = _actor_log(content, file, number)
    calibration = read_camera_option(camera)
    rig = _chosen_rig(calibration, only, size, photo)
    style = _style(palette, occlusion, photo)
    writable_folder(path.parent)
    try:
        if photo is not None:
            written = _write_overlay(photo, log, calibration, rig, step or 0, actor, style, path)
        else:
            carrier = {"actor": actor, "poses": None if at is None else _place_poses(at, log)}
            first = _renderer(log, rig, carrier, style, weather, seed)
            written = _write_views(first, rig, path, video=video, step=step, buffers=buffers)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    click.echo("\n".join(written))


def _checked_path(out: str, video: bool, step: Any, photo: Any, buffers: bool, actor: Any, at: Any) -> Path:
    """The path to write, if it fits the other options.

    Raises:
      UsageError: options exclude each other.
      ValueError: OpenCV, or PyAV for an MP4, is missing.
    """
    path = Path(out)
    endings = _VIDEOS if video else _PICTURES
    if path.suffix not in endings:
        what = "--video writes .mp4 or .gif files" if video else "pictures are .png files; --video writes .mp4 or .gif"
        raise click.UsageError(f"--out is {out}: {what}")
    if video and (step is not None or photo is not None or buffers):
        raise click.UsageError("--frame, --photo and --buffers are for pictures: leave --video out")
    if at is not None and (actor is not None or photo is not None):
        raise click.UsageError("--at, --actor and --photo say where the camera is: give one of them")
    from scjax.camera.raster import require_opencv

    require_opencv()
    if path.suffix == ".mp4":
        from scjax.viz.video_file import video_suffix

        video_suffix(path)
    return path


def _actor_log(content: Scene | Log | Map, file: str, number: int | None) -> Log:
    """The content of a file as a log; agent 0 of a scene is its ego."""
    import dataclasses

    from scjax.scene import Scene

    log = log_of_content(content, file, number)
    return dataclasses.replace(log, ego_index=0) if isinstance(content, Scene) and log.num_objects else log


def _chosen_rig(calibration: CameraCalibration, only: tuple[str, ...], size: Any, photo: str | None) -> Rig:
    rig = calibration.rig.select(*only) if only else calibration.rig
    if photo is not None:
        rig = rig_of_photo(calibration, rig, photo, "--only")
    return rig.fitted(*size) if size else rig


def _style(palette: str, occlusion: bool | None, photo: str | None) -> WireframeStyle:
    from scjax.camera import WireframeStyle

    covers = photo is None if occlusion is None else occlusion
    return WireframeStyle(palette=palette, occlusion=covers, depth_cue=0.6 if photo is None else 0.3)


def _place_poses(at: tuple[float, ...], log: Log) -> CameraPoses:
    """Poses of a rig that stands still, on the ground."""
    import numpy as np

    from scjax.camera import CameraPoses
    from scjax.camera.source_log import ground_of

    yaw = float(np.deg2rad(at[2])) if len(at) == 3 else 0.0
    cos, sin = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    height = float(ground_of(log).heights(np.array([at[:2]]), 0)[0])
    steps = log.num_steps
    return CameraPoses(np.tile(rotation, (steps, 1, 1)), np.tile([at[0], at[1], height], (steps, 1)))


def _write_overlay(
    photo: str,
    log: Log,
    calibration: CameraCalibration,
    rig: Rig,
    step: int,
    actor: int | None,
    style: WireframeStyle,
    path: Path,
) -> list[str]:
    from scjax.camera import overlay

    if step >= log.num_steps:
        raise ValueError(f"--frame is {step}: give one of the {log.num_steps} steps, counted from 0")
    poses = calibration.poses.get(rig.camera().name) if actor is None else None
    picture = overlay(photo, log[step : step + 1], rig, actor=actor, poses=poses, style=style)
    _save_png(picture, path)
    return [str(path)]


def _renderer(
    log: Log, rig: Rig, carrier: dict[str, Any], style: WireframeStyle, weather: str | None, seed: int
) -> WireframeRenderer | DashcamRenderer:
    """The renderer of the first camera of a rig."""
    from scjax.camera import WireframeRenderer
    from scjax.camera.dashcam import DashcamRenderer, random_look

    name = rig.cameras[0].name
    if weather is None:
        return WireframeRenderer(log, rig, name, style=style, **carrier)
    look = random_look(seed, None if weather == "any" else weather)
    return DashcamRenderer(log, rig, name, look=look, supersampling=2, **carrier)


def _write_views(
    first: WireframeRenderer | DashcamRenderer, rig: Rig, path: Path, *, video: bool, step: int | None, buffers: bool
) -> list[str]:
    """Writes a picture or a video of every camera, then the poses."""
    from scjax.camera import write_camera_poses

    renderers = [first, *(first.through(camera.name) for camera in rig.cameras[1:])]
    steps = renderers[0].steps if video else [int(renderers[0].steps[0]) if step is None else step]
    written = []
    for renderer in renderers:
        name = path if len(renderers) == 1 else path.with_name(f"{path.stem}-{renderer.camera.name}{path.suffix}")
        if video:
            _write_frames(renderer, name)
            written.append(str(name))
        else:
            written += _write_picture(renderer, int(steps[0]), name, buffers)
    sidecar = path.with_suffix(".cameras.json")
    write_camera_poses(renderers, steps, sidecar)
    return [*written, str(sidecar)]


def _write_picture(renderer: WireframeRenderer | DashcamRenderer, step: int, path: Path, buffers: bool) -> list[str]:
    import numpy as np

    from scjax.camera import WireframeRenderer
    from scjax.scene.files import write_file

    is_wireframe = isinstance(renderer, WireframeRenderer)
    frame = renderer.frame(step, buffers=buffers) if is_wireframe else renderer.frame(step)
    _save_png(frame.rgb, path)
    if not buffers:
        return [str(path)]
    arrays = {name: value for name, value in frame._asdict().items() if name in ("depth", "ids", "kinds", "classes")}
    beside = path.with_suffix(".npz")
    write_file(beside, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))
    return [str(path), str(beside)]


def _write_frames(renderer: WireframeRenderer | DashcamRenderer, path: Path) -> None:
    from tqdm import tqdm

    from scjax.camera import PALETTES, WireframeRenderer
    from scjax.viz.animation import MAX_FRAMES, MAX_GIF_FRAMES
    from scjax.viz.video_file import write_video

    steps, limit = renderer.steps, MAX_GIF_FRAMES if path.suffix == ".gif" else MAX_FRAMES
    if not 1 < len(steps) <= limit:
        raise ValueError(
            f"a {path.suffix} file has 2 to {limit} frames, and the carrier is there at {len(steps)} steps"
        )
    times = renderer.log.timestamps[steps]
    rate = float((len(steps) - 1) / (times[-1] - times[0]))
    colors = set()
    if isinstance(renderer, WireframeRenderer):
        palette = PALETTES[renderer.style.palette]
        colors = {*palette.agents.values(), *palette.signals.values(), palette.lane, palette.border}
    names = ["#{:02x}{:02x}{:02x}".format(*color) for color in sorted(colors)]
    try:
        with tqdm(total=len(steps), desc=path.name, unit="frame", delay=1.0, disable=None) as bar:

            def counted() -> Iterator[Any]:
                for picture in renderer.frames():
                    yield picture
                    bar.update()

            write_video(counted(), path, rate, names)
    except MemoryError as error:
        raise ValueError(f"{path}: {len(steps)} frames do not fit the memory: write an .mp4") from error
    say(f"{path}: {len(steps)} frames, {rate:.3g} a second")


def _save_png(picture: Any, path: Path) -> None:
    from PIL import Image

    from scjax.scene.files import write_file

    write_file(path, lambda file: Image.fromarray(picture).save(file, "PNG"))
