"""Features of pictures as the ablation reads them: the rows of cells that show the road, in units of their spread.

    scjax data embed-images runs/pictures runs/features
    python -m experiments.studies.ablation.road_features runs/features runs/road

Above its horizon a standard view shows sky and house fronts. Cells there cost as much as others and say nothing of
lanes and agents. Numbers of the network that ships differ tenfold in size. Each number gets mean 0 and deviation 1 over
cells of training pictures, as in networks whose last layer is a norm. The result is a folder like the first.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from experiments.studies.page import script_parser
from scjax.data.image_features import ImageEntry, ImageIndex, ImageStore
from scjax.encoders.feature_cache import FeatureCache
from scjax.encoders.vision import GridTokens
from scjax.scene.files import locked_folder, write_file

FIRST_ROW = 6
"""First of 14 rows of cells that is kept: the horizon is between rows 6 and 7, and vehicles reach above it."""

_MEASURED = 500  # pictures whose cells give means and deviations
_LEAST = 1e-3  # deviation


def write_road_features(features: Path, out: Path, first_row: int = FIRST_ROW) -> ImageIndex:
    """Keeps the rows of cells from ``first_row`` on, with standardized numbers, of all pictures; depth is left out.

    Returns:
      What OUT/images.json lists.

    Raises:
      ValueError: there are no features of training pictures, or they have no such row.
    """
    store = ImageStore(features)
    rows, columns = store.grid
    if not 0 <= first_row < rows:
        raise ValueError(f"{features} has rows 0 to {rows - 1}: give one of them, not {first_row}")
    measured = [file for file in store.files if Path(file).name.startswith("train-")]
    if not measured:
        raise ValueError(f"{features} has no pictures of training records: see scjax data dashcam --help")
    mean, deviation = _spread(store, measured[:: -(-len(measured) // _MEASURED)], first_row * columns)
    with locked_folder(out):
        cache, entries = FeatureCache(out / "features"), []
        for number, file in enumerate(store.files):
            image, key = store.image(file), f"{number % 256:02x}-{Path(file).stem}"
            tokens, mask = image.tokens[first_row * columns :], image.mask[first_row * columns :]
            scaled = np.where(mask[:, None], (tokens - mean) / deviation, 0).astype(np.float32)
            cache.write(key, GridTokens(scaled, mask, (rows - first_row, columns)))
            entries.append(ImageEntry(file, key, ""))
        index = ImageIndex(
            format=1,
            encoder=f"{store.encoder}, standardized from row {first_row}",
            width=store.width,
            preprocessing=f"rows from {first_row}",
            grid=(rows - first_row, columns),
            images=entries,
            skipped=[],
        )
        write_file(out / "images.json", lambda file: file.write(msgspec.json.encode(index)))
    return index


def _spread(
    store: ImageStore, files: Sequence[str], first_cell: int
) -> tuple[Float[np.ndarray, " width"], Float[np.ndarray, " width"]]:
    """Mean and deviation of each number over the readable cells from ``first_cell`` on."""
    images = [store.image(file) for file in files]
    cells = np.concatenate([image.tokens[first_cell:][image.mask[first_cell:]] for image in images])
    if not len(cells):
        raise ValueError("no cell of these rows can be read: begin at another row")
    return cells.mean(0), np.maximum(cells.std(0), _LEAST)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.ablation.road_features", __doc__)
    parser.add_argument("features", type=Path, help="folder of scjax data embed-images")
    parser.add_argument("out", type=Path, help="folder that receives the features")
    args = parser.parse_args(arguments)
    try:
        index = write_road_features(args.features, args.out)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.ablation.road_features: {error}")
    print(f"{len(index.images)} pictures of {index.grid[0]} x {index.grid[1]} cells in {args.out}")


if __name__ == "__main__":
    main()
