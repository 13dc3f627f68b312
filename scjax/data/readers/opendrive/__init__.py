"""Reader of OpenDRIVE maps (.xodr), by our own code."""

from scjax.data.readers.opendrive.reader import OPENDRIVE, read_opendrive, read_road_map

__all__ = ["OPENDRIVE", "read_opendrive", "read_road_map"]
