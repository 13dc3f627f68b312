"""The scene types, their frames, files and repairs; imports nothing else of scjax."""

from scjax.scene.log import NO_EGO, OTHER_OBJECT, Log, LogMetadata, validate_log
from scjax.scene.log_io import load_log, save_log
from scjax.scene.map import Map, MapRoute, MapSeam, MapTile, TileStatus, validate_map
from scjax.scene.map_forms import join_maps, log_to_map, map_to_log, scene_to_map
from scjax.scene.map_io import load_map, save_map
from scjax.scene.map_lane import LaneNeighbor, MapLane
from scjax.scene.map_routes import find_route, measure_seam, route_line
from scjax.scene.scene import (
    INVERSE_LINK,
    MAX_AGENTS,
    MAX_LANES,
    POINTS_PER_LANE,
    STATE_COLUMNS,
    TILE_SIZE,
    AgentType,
    AnyArray,
    Crop,
    Link,
    Scene,
    Signal,
    empty,
    pad,
    permute,
    stack,
    unpadded,
    validate,
)

__all__ = [
    "INVERSE_LINK",
    "MAX_AGENTS",
    "MAX_LANES",
    "NO_EGO",
    "OTHER_OBJECT",
    "POINTS_PER_LANE",
    "STATE_COLUMNS",
    "TILE_SIZE",
    "AgentType",
    "AnyArray",
    "Crop",
    "LaneNeighbor",
    "Link",
    "Log",
    "LogMetadata",
    "Map",
    "MapLane",
    "MapRoute",
    "MapSeam",
    "MapTile",
    "Scene",
    "Signal",
    "TileStatus",
    "empty",
    "find_route",
    "join_maps",
    "load_log",
    "load_map",
    "log_to_map",
    "map_to_log",
    "measure_seam",
    "pad",
    "permute",
    "route_line",
    "save_log",
    "save_map",
    "scene_to_map",
    "stack",
    "unpadded",
    "validate",
    "validate_log",
    "validate_map",
]
