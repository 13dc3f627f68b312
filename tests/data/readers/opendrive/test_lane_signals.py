import pytest

from scjax.data.readers.opendrive.road_map import RoadMap, build_road_map
from tests.factories import opendrive_files as files
from tests.factories.opendrive_files import lane, road, section


def _signal(
    kind: str = "1000001", s: float = 90.0, orientation: str = "+", validity: str = "", number: str = "5"
) -> str:
    return (
        f'<signal id="{number}" s="{s}" t="-4" dynamic="yes" orientation="{orientation}" country="OpenDRIVE" '
        f'type="{kind}" subtype="-1">{validity}</signal>'
    )


def _map(signal: str, at: int = 0) -> RoadMap:
    """The fork with a signal on its first (``at``-th) road."""
    content = list(files.fork())
    content[at] = content[at].replace("<signals></signals>", f"<signals>{signal}</signals>")
    return build_road_map(files.root(*content))


def _lanes(road_map: RoadMap) -> set[str]:
    return set(map(str, road_map.signal_lanes))


def test_light_before_a_junction_controls_the_ways_through_it():
    assert _lanes(_map(_signal())) == {"4.0.-1", "5.0.1"}


def test_light_for_the_other_direction_controls_none():
    assert _lanes(_map(_signal(orientation="-"))) == set()


def test_light_for_both_directions_controls_all():
    assert _lanes(_map(_signal(orientation="none"))) == {"4.0.-1", "5.0.1"}


def test_named_lanes_count_more_than_the_orientation():
    assert _lanes(_map(_signal(orientation="-", validity='<validity fromLane="-1" toLane="-1"/>'))) == {
        "4.0.-1",
        "5.0.1",
    }


def test_validity_of_no_lane_is_a_post():
    assert _lanes(_map(_signal(validity='<validity fromLane="0" toLane="0"/>'))) == set()


def test_reference_on_a_way_controls_that_way():
    post = _signal(validity='<validity fromLane="0" toLane="0"/>')
    content = list(files.fork())
    content[0] = content[0].replace("<signals></signals>", f"<signals>{post}</signals>")
    reference = (
        '<signalReference id="5" s="1" t="0" orientation="+"><validity fromLane="1" toLane="1"/></signalReference>'
    )
    content[4] = content[4].replace("<signals></signals>", f"<signals>{reference}</signals>")
    assert _lanes(build_road_map(files.root(*content))) == {"5.0.1"}


def test_light_without_a_junction_controls_its_own_lane():
    single = road("1", section(lane(1), lane(-1)), signals=_signal())
    assert _lanes(build_road_map(files.root(single))) == {"1.0.-1"}


@pytest.mark.parametrize("word", ["1000001", "1.000.001", "1000011", "1000009", "1000020"])
def test_lights_for_cars_are_read(word):
    assert _lanes(_map(_signal(word)))


@pytest.mark.parametrize(
    ("word", "note"),
    [
        ("206", "stop signs, not read"),
        ("R1-1", "stop signs, not read"),
        ("205", "yield signs, not read"),
        ("1000002", "lights for pedestrians, cyclists, trams or lanes, not read"),
        ("1000013", "lights for pedestrians, cyclists, trams or lanes, not read"),
        ("7", "dynamic signals of other types, not read"),
    ],
)
def test_other_signals_are_counted(word, note):
    road_map = _map(_signal(word))
    assert not road_map.signal_lanes and road_map.notes == {note: 1}


def test_signal_without_a_place_is_refused():
    with pytest.raises(ValueError, match="<signal id='5'>: has no s"):
        _map('<signal id="5" type="1000001"/>')
