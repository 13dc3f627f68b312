"""What was seen in the pictures of maps, one line each, by name of the file."""

SEEN: dict[str, str] = {}
SHEET: tuple[str, ...] = (
    "CHN_Roundabout-1.xml",
    "USA_Lanker-1_17_T-1.xml",
    "DEU_TrafficLightTest-1.xml",
    "FRA_Anglet-1_1_T-1.xml",
    "mapping_example.osm",
    "lanelet2_map.osm",
    "ZalaZone_Uni_track_full_early.osm",
    "Town03.xodr",
    "Roundabout8Course.xodr",
    "fabriksgatan.xodr",
    "sd_waymo_v1.2_eb4b91b10ca94ff2.pkl",
    "log_map_archive_7fab2350-7eaf-3b7e-a39d-6937a4c1bede____PIT_city_47896.json",
)
"""Files on the sheet of the page."""
