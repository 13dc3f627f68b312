"""What does the vision network that ships see, in rendered pictures and in photographs?

    python -m experiments.studies.vision --pictures runs/pictures --out docs/results/vision \\
        --photos CALIBRATION.json ...

Rendered pictures are those of held-back worlds (scjax data dashcam). Photographs come with the calibration of their
cameras and the boxes around them, of nuScenes or Waymo; every camera counts as one that looks ahead.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from experiments.studies.page import command_line, new_figure, script_parser, table_lines, write_page
from scjax.camera.agent_boxes import box_corners_3d
from scjax.camera.calibrations import read_calibration
from scjax.camera.camera import Camera
from scjax.camera.photo import Photo, open_photo, photo_from_array
from scjax.camera.projection import project_points
from scjax.camera.rig import carried_poses
from scjax.camera.standard_view import STANDARD_AHEAD, STANDARD_SIZE, standard_camera, standard_view
from scjax.data.imports import import_log
from scjax.encoders.dashcam_network import PLACE_SCALE, FineCells
from scjax.encoders.dashcam_weights import MODEL_TYPE, NETWORK, dashcam_functions
from scjax.encoders.image_network import load_network
from scjax.encoders.preprocessing import SQUASH, prepare_image
from scjax.scene import AgentType
from scjax.synthetic.pictures import read_rendered
from scjax.train.picture_loader import picture_rows

_REACH = 40.0  # m
_SHOWN = 4


class Seen(NamedTuple):
    """Vehicles in pictures: whether each was found, its distance [m] and the error of its place [m]."""

    found: np.ndarray
    distance: np.ndarray
    error: np.ndarray


class CalibratedPhoto(NamedTuple):
    """A photograph with the places of vehicles in the frame of its camera's direction, and their pixels."""

    photo: Photo
    places: Float[np.ndarray, "n 2"]
    pixels: Float[np.ndarray, "n 2"]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.vision", __doc__)
    parser.add_argument("--encoder", type=Path, default=Path("scjax/pretrained_vision"), help="(default: %(default)s)")
    parser.add_argument("--pictures", type=Path, required=True, help="folder of scjax data dashcam")
    parser.add_argument("--number", type=int, default=400, help="of rendered pictures (default: %(default)s)")
    parser.add_argument("--photos", nargs="*", default=(), help="calibrations with the boxes around their cameras")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")
    args = parser.parse_args(arguments)
    loaded = load_network(args.encoder, {MODEL_TYPE: NETWORK}, "float32")
    network = dashcam_functions(loaded.config)
    run = jax.jit(lambda pixels: network.apply(loaded.params, pixels, method="cells"))

    def cells_of(photo: Photo) -> FineCells:
        pixels = prepare_image(photo, SQUASH, loaded.config.patch_size).pixels
        return FineCells(*(np.asarray(part)[0] for part in run(pixels[None])))

    rows = picture_rows(args.pictures, "val")
    rows = rows[:: max(len(rows) // args.number, 1)][: args.number]
    rendered = [_rendered(args.pictures, row, cells_of) for row in tqdm(rows, "rendered pictures")]
    photos = {Path(path).parent.name: _photographs(path, cells_of) for path in args.photos}
    content = {
        "rendered": {name: float(np.nanmean([one[name] for one in rendered])) for name in rendered[0]},
        "pictures": len(rows),
        "photos": {name: _summary(seen) for name, seen in photos.items()},
    }
    figure = _figure(args.pictures, rows[:: max(len(rows) // _SHOWN, 1)][:_SHOWN], cells_of)
    write_page(args.out, _page(content, command_line("vision", arguments)), content, figure)


def _rendered(folder: Path, row: int, cells_of: Any) -> dict[str, float]:
    """Measures of one rendered picture; NaN where it shows nothing of the kind."""
    pixels, targets = read_rendered(folder, "val", row)
    cells = cells_of(photo_from_array(np.ascontiguousarray(pixels)))
    objects, lanes = targets.objects.astype(np.float64), targets.lanes.astype(np.float64)
    near = (objects[..., 6] > 0) & (np.hypot(objects[..., 0], objects[..., 1]) < _REACH)
    apart = np.hypot(*np.moveaxis(PLACE_SCALE * cells.objects[..., :2] - objects[..., :2], -1, 0))
    found = cells.objects[..., 6] > 0
    ground = targets.depth < 60
    ratio = np.exp(np.abs(cells.depth - np.log(targets.depth.astype(np.float64))))
    return {
        "cells of the right class": float((cells.classes.argmax(-1) == targets.classes.argmax(-1)).mean()),
        "depth within 10 %, to 60 m": _mean(ratio[ground] < 1.1),
        "cells of objects to 40 m found": _mean(found[near]),
        "cells that show an object, of those said to": _mean((objects[..., 6] > 0)[found]),
        "objects to 40 m: median error of the place [m]": _median(apart[near]),
        "lanes: median error across [m]": _median(np.abs(4 * cells.lanes[..., 4] - lanes[..., 4])[lanes[..., 5] > 0]),
    }


def _photographs(path: str, cells_of: Any) -> Seen:
    """What is found in the photographs of a calibration."""
    found, distances, errors = [], [], []
    for view in _calibrated(Path(path)):
        cells = cells_of(view.photo)
        width, height = STANDARD_SIZE
        rows, columns = cells.depth.shape
        for place, pixel in zip(view.places, view.pixels, strict=True):
            row, column = int((pixel[1] + 0.5) / height * rows), int((pixel[0] + 0.5) / width * columns)
            window = slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2)
            around = cells.objects[window].reshape(-1, 7)
            best = around[around[:, 6].argmax()]
            found.append(best[6] > 0)
            distances.append(np.hypot(*place))
            errors.append(np.hypot(*(PLACE_SCALE * best[:2] - place)))
    return Seen(np.array(found, bool), np.array(distances), np.array(errors))


def _calibrated(path: Path) -> Iterator[CalibratedPhoto]:
    """Standard views of the photographs of a sample, with the vehicles whose middles they show."""
    calibration, document = read_calibration(path), json.loads(path.read_text())
    middles, sizes, headings = _world_boxes(path, document)
    for camera in calibration.rig.cameras:
        poses = carried_poses(camera, calibration.poses[camera.name])
        rotation, position = poses.rotations[0], poses.translations[0]
        corners = box_corners_3d(middles, headings, sizes)
        local, local_corners = (middles - position) @ rotation, (corners - position) @ rotation
        shown = _shown(camera, local, local_corners)
        height = float(calibration.rig.origin[2] + camera.translation[2])
        yaw = np.arctan2(rotation[1, 2], rotation[0, 2])
        turn = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        mount = np.array([STANDARD_AHEAD, 0.0, height])
        places = (middles[shown] - position) @ turn.T + mount
        ahead = dataclasses.replace(camera, rotation=turn @ rotation, translation=mount)
        view = standard_camera(height)
        pixels = project_points(view, (places - mount) @ view.rotation).pixels
        inside = ((pixels >= 0) & (pixels < np.array(STANDARD_SIZE) - 1)).all(1)
        photo = standard_view(open_photo(path.parent / calibration.pictures[camera.name]), ahead)
        yield CalibratedPhoto(photo, places[inside, :2], pixels[inside])


def _world_boxes(path: Path, document: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middles, sizes and headings of all vehicles in the world."""
    if "boxes_vehicle_frame" in document:
        boxes = [box for box in document["boxes_vehicle_frame"] if box["type"] == "vehicle"]
        matrix = np.array(document["vehicle_to_world_4x4"]).reshape(4, 4)
        middles = np.array([[box[axis] for axis in "xyz"] for box in boxes]) @ matrix[:3, :3].T + matrix[:3, 3]
        sizes = np.array([[box[name] for name in ("length", "width", "height")] for box in boxes])
        return middles, sizes, np.array([box["heading"] for box in boxes]) + np.arctan2(matrix[1, 0], matrix[0, 0])
    log = import_log(path.parent / document["scene_file"])
    step = int(np.abs(log.timestamps - log.timestamps[0] - document.get("scene_time_s", 0.0)).argmin())
    rows = log.valid[:, step] & (log.object_types == AgentType.VEHICLE)
    rows[max(log.ego_index, 0)] &= log.ego_index < 0
    return log.positions[rows, step], log.sizes[rows], log.headings[rows, step]


def _shown(camera: Camera, local: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Rows of the boxes within reach whose middle lies in the picture and behind no nearer box."""
    image = project_points(camera, local)
    inside = ((image.pixels >= 0) & (image.pixels < (camera.width, camera.height))).all(1)
    near = (local[:, 2] > 1) & (np.hypot(local[:, 0], local[:, 2]) < _REACH)
    rows = np.flatnonzero(image.visible & inside & near)
    kept: list[int] = []
    for row in rows[np.argsort(local[rows, 2])].tolist():
        pixel = image.pixels[row]
        spans = [shown.pixels[shown.visible] for shown in (project_points(camera, corners[other]) for other in kept)]
        hidden = [len(span) and (span.min(0) <= pixel).all() and (pixel <= span.max(0)).all() for span in spans]
        if not any(hidden):
            kept.append(row)
    return np.array(kept, int)


def _summary(seen: Seen) -> dict[str, float]:
    return {
        "vehicles to 40 m": len(seen.found),
        "found": _mean(seen.found),
        "median error of the place of those [m]": _median(seen.error[seen.found]),
        "within 20 % of the distance, of all": _mean(seen.found & (seen.error < 0.2 * seen.distance)),
    }


def _page(content: dict[str, Any], command: str) -> str:
    lines = [
        "# What the vision network sees",
        "",
        f"`{command}`",
        "",
        f"Rendered pictures of {content['pictures']} records of worlds that were held back; means over pictures.",
        "",
        *table_lines(("measure", "value"), [(name, f"{value:.2f}") for name, value in content["rendered"].items()]),
    ]
    if content["photos"]:
        names = list(next(iter(content["photos"].values())))
        rows = [(place, *(f"{values[name]:.2f}" for name in names)) for place, values in content["photos"].items()]
        lines += [
            "",
            "Photographs, all cameras of one moment. No photograph was in the training. A vehicle counts as found",
            "where one of the nine cells around its middle says that there is an object.",
            "",
            *table_lines(("moment", *names), rows),
        ]
    return "\n".join(lines) + "\n"


def _figure(folder: Path, rows: Sequence[int], cells_of: Any) -> Any:
    """Pictures, and beside each the classes and the depth that the network sees."""
    figure = new_figure(7, 1.35 * len(rows))
    axes = figure.subplots(len(rows), 3, squeeze=False)
    for place, row in enumerate(rows):
        pixels, _ = read_rendered(folder, "val", row)
        cells = cells_of(photo_from_array(np.ascontiguousarray(pixels)))
        shown = (pixels, cells.classes.argmax(-1), cells.depth)
        options = (
            {},
            {"cmap": "tab20", "vmin": 0, "vmax": 19},
            {"cmap": "viridis_r", "vmin": np.log(4), "vmax": np.log(100)},
        )
        for axis, values, given in zip(axes[place], shown, options, strict=True):
            axis.imshow(values, aspect="auto", interpolation="nearest", extent=(0, 16, 9, 0), **given)
            axis.set_axis_off()
    for axis, title in zip(axes[0], ("picture", "classes", "depth"), strict=True):
        axis.set_title(title, fontsize=8)
    return figure


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else float("nan")


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if values.size else float("nan")


if __name__ == "__main__":
    main()
