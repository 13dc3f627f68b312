"""Types of lanes: the words of the file as those of ``MapLane``."""

from __future__ import annotations

from collections import Counter

from scjax.data.readers.opendrive.lane_lines import LaneLine
from scjax.data.readers.vocabulary import LANE_WORDS, look_up
from scjax.scene.map_lane import NO_CAR_LANE_TYPES


class LaneTypes:
    """Translates words, and counts those that no table has.

    Attributes:
      unknown_words: "lane type: word" -> how often.
    """

    def __init__(self):
        self.unknown_words: Counter[str] = Counter()

    def of(self, line: LaneLine, is_linked: bool) -> str | None:
        """The type of a lane.

        A lane for both directions that is linked to nothing, between the directions of a road, is "undefined": no way
        leads through it. Lanes for cars of a motorway are "freeway".
        """
        word = line.lane.type
        lane_type = look_up(LANE_WORDS, word, None, "lane type", self.unknown_words)
        if word == "bidirectional" and not is_linked:
            return "undefined"
        return "freeway" if lane_type == "surface_street" and line.is_motorway else lane_type

    def is_for_cars(self, line: LaneLine) -> bool:
        """Whether cars drive on a lane."""
        return look_up(LANE_WORDS, line.lane.type, None, "", Counter()) not in NO_CAR_LANE_TYPES
