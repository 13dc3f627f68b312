"""Reader of CommonRoad scenarios (.xml), by our own code."""

from scjax.data.readers.commonroad.reader import COMMONROAD, read_commonroad

__all__ = ["COMMONROAD", "read_commonroad"]
