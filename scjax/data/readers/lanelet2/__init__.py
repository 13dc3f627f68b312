"""Reader of Lanelet2 maps (.osm), by our own code."""

from scjax.data.readers.lanelet2.reader import LANELET2, read_lanelet2

__all__ = ["LANELET2", "read_lanelet2"]
