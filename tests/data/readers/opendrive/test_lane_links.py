import numpy as np
import pytest

from scjax.data.readers.opendrive.road_map import RoadMap, build_road_map
from tests.factories import opendrive_files as files
from tests.factories.opendrive_files import cubic, follows, geometry, lane, road, section


def _map(*content: str) -> RoadMap:
    return build_road_map(files.root(*content))


def _links(road_map: RoadMap) -> set[str]:
    return {f"{a} > {b}" for a, followers in road_map.successors.items() for b in followers}


def _gaps(road_map: RoadMap) -> list[float]:
    lines = road_map.lines
    return [
        float(np.linalg.norm(lines[b].points[0] - lines[a].points[-1]))
        for a, followers in road_map.successors.items()
        for b in followers
    ]


def test_sections_follow_by_their_lane_links():
    first = section(lane(1, predecessor=None, successor=1), lane(-1, successor=-2), lane(-2, width=2.0, successor=-3))
    second = section(lane(1, predecessor=1), lane(-1), lane(-2, predecessor=-1), lane(-3, 2.0), s=50)
    links = _links(_map(road("7", first, second)))
    assert links == {"7.1.1 > 7.0.1", "7.0.-1 > 7.1.-2", "7.0.-2 > 7.1.-3"}


def test_one_end_of_a_link_is_enough():
    first, second = section(lane(-1)), section(lane(-1, predecessor=-1), s=50)
    assert _links(_map(road("7", first, second))) == {"7.0.-1 > 7.1.-1"}


def test_roads_follow_by_their_contact_points():
    # MapRoad 2 is drawn towards road 1: their ends touch, and lanes change their sign.
    one = road("1", section(lane(1, successor=-1), lane(-1, successor=1)), links=follows("successor", "2", "end"))
    two = road(
        "2",
        section(lane(1, successor=-1), lane(-1, successor=1)),
        plan=geometry(x=200, heading=np.pi),
        links=follows("successor", "1", "end"),
    )
    road_map = _map(one, two)
    assert _links(road_map) == {"1.0.-1 > 2.0.1", "2.0.-1 > 1.0.1"} and max(_gaps(road_map)) < 1e-6


def test_file_without_lane_links_joins_lanes_of_one_id():
    one = road("1", section(lane(-1)), section(lane(-1), s=50), links=follows("successor", "2"))
    two = road("2", section(lane(-1)), plan=geometry(x=100))
    assert _links(_map(one, two)) == {"1.0.-1 > 1.1.-1", "1.1.-1 > 2.0.-1"}


@pytest.mark.parametrize("rule", ["RHT", "LHT"])
def test_junction_leads_into_its_ways_and_out_of_them(rule):
    content = files.fork()
    if rule == "LHT":  # the same roads: traffic drives them the other way
        content = tuple(text.replace("<road ", '<road rule="LHT" ') for text in content)
    road_map = _map(*content)
    expected = {"1.0.-1 > 4.0.-1", "1.0.-1 > 5.0.1", "4.0.-1 > 2.0.-1", "5.0.1 > 3.0.-1"}
    if rule == "LHT":
        expected = {" > ".join(reversed(link.split(" > "))) for link in expected}
    assert _links(road_map) == expected and max(_gaps(road_map)) < 1e-6


def test_way_drawn_from_its_end_is_driven_from_its_start():
    points = next(line for key, line in _map(*files.fork()).lines.items() if key.road == "5").points
    np.testing.assert_allclose(points[[0, -1], :2], [[100, 0], [110, 10]], atol=1e-6)
    np.testing.assert_allclose(np.hypot(points[:, 0] - 100, points[:, 1] - 10), 10, atol=1e-6)


def test_junction_links_alone_find_the_end_that_touches():
    """The ways name no road; both ends of road 1 lead to the junction."""
    content = [text.replace("<predecessor elementType", "<x elementType") for text in files.fork()]
    content = [text.replace("<successor elementType", "<x elementType") for text in content]
    content[0] = content[0].replace(
        "<link>", f"<link>{files.leads_to('predecessor', '9')}{files.leads_to('successor', '9')}", 1
    )
    assert {"1.0.-1 > 4.0.-1", "1.0.-1 > 5.0.1"} <= _links(_map(*content))


def test_direct_junction_joins_roads():
    one = road("1", section(lane(-1)), links=files.leads_to("successor", "9"))
    two = road("2", section(lane(-1, predecessor=-1), lane(-2)), plan=geometry(x=100))
    junction = (
        '<junction id="9" type="direct"><connection id="0" incomingRoad="1" linkedRoad="2" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection></junction>'
    )
    assert _links(_map(one, two, junction)) == {"1.0.-1 > 2.0.-1"}


def test_virtual_junction_ends_no_road():
    junction = (
        '<junction id="9" type="virtual" mainRoad="1"><connection id="0" incomingRoad="1" connectingRoad="1" '
        'contactPoint="start"><laneLink from="-1" to="-1"/></connection></junction>'
    )
    assert _links(_map(road("1"), junction)) == set()


def test_links_to_what_is_not_there_are_counted():
    one = road("1", section(lane(-1, successor=-4)), section(lane(-1), s=50), links=follows("successor", "8"))
    notes = _map(one, '<junction id="9"><connection incomingRoad="1" connectingRoad="77"/></junction>').notes
    assert notes == {"links to missing roads, not read": 2, "links to missing lanes, not read": 1}


@pytest.mark.parametrize(("other", "more"), [(1, ""), (-1, 'direction="reversed"')])
def test_lanes_that_drive_towards_each_other_do_not_follow(other, more):
    road_map = _map(road("1", section(lane(-1, successor=other)), section(lane(other, more=more), s=50)))
    assert not road_map.successors
    assert road_map.notes == {"links between lanes that drive towards each other, not read": 1}


def test_ends_a_little_apart_are_drawn_together():
    first = section(lane(-1, width=3.0, successor=-1))
    second = section(lane(-1, width=3.25, predecessor=-1), s=50)
    road_map = _map(road("1", first, second, length=100.0))
    assert max(_gaps(road_map)) < 1e-9
    ends = [line.points[[0, -1], 1] for line in road_map.lines.values()]
    np.testing.assert_allclose([ends[0][0], ends[1][1]], [-1.5, -1.625])


def test_lane_that_parts_into_two_begins_both_in_its_middle():
    first = section(lane(-1, width=6.0))
    second = section(lane(-1, width=3.0, predecessor=-1), lane(-2, width=3.0, predecessor=-1), s=40)
    road_map = _map(road("1", first, second))
    assert len(_gaps(road_map)) == 2 and max(_gaps(road_map)) < 1e-9
    ends = {key.lane: line.points[-1, 1] for key, line in road_map.lines.items() if key.section == 1}
    assert ends == {-1: pytest.approx(-1.5), -2: pytest.approx(-4.5)}


def test_two_lanes_that_the_file_merges_end_in_one():
    first = section(lane(-1, successor=-1), lane(-2, successor=-1))
    road_map = _map(road("1", first, section(lane(-1), s=50)))
    assert len(_gaps(road_map)) == 2 and max(_gaps(road_map)) < 1e-9
    points = next(line.points for key, line in road_map.lines.items() if key.lane == -2)
    np.testing.assert_allclose(points[[0, -1], 1], [-5.25, -1.75], atol=1e-6)


def test_ends_far_apart_stay_there():
    first, second = section(lane(-1), lane(-2), lane(-3, successor=-1)), section(lane(-1), s=50)
    assert _gaps(_map(road("1", first, second))) == [pytest.approx(7.0)]


def _with_pocket(first_width: str) -> RoadMap:
    """A lane that opens on the right in the second of three sections."""
    sections = (
        section(lane(-1, successor=-1)),
        section(lane(-1, predecessor=-1, successor=-1), lane(-2, width=first_width, successor=-2), s=30),
        section(lane(-1, predecessor=-1), lane(-2, predecessor=-2), s=70),
    )
    return _map(road("1", *sections))


def test_lane_that_opens_leaves_the_lane_beside_it():
    # From 0 to 3.5 m wide within 40 m, with level ends.
    road_map = _with_pocket(cubic("width", 0, 0, 3 * 3.5 / 40**2, -2 * 3.5 / 40**3, start="sOffset"))
    assert "1.0.-1 > 1.1.-2" in _links(road_map) and max(_gaps(road_map)) < 1e-6
    points = next(line.points for key, line in road_map.lines.items() if (key.section, key.lane) == (1, -2))
    np.testing.assert_allclose(points[[0, -1], 1], [-1.75, -5.25], atol=1e-6)
    headings = np.arctan2(*np.diff(points[:, :2], axis=0).T[::-1])
    assert abs(headings[0]) < np.deg2rad(2) and np.abs(np.diff(headings)).max() < np.deg2rad(4)


def test_lane_that_opens_in_a_section_cuts_it():
    widths = cubic("width", 0.0, start="sOffset") + cubic(
        "width", 0, 0, 3 * 3.5 / 900, -2 * 3.5 / 27000, s=10, start="sOffset"
    )
    links = _links(_with_pocket(widths))
    assert {"1.0.-1 > 1.1.-1", "1.1.-1 > 1.2.-1", "1.1.-1 > 1.2.-2"} <= links


def test_lane_that_closes_ends_in_the_lane_beside_it():
    width = cubic("width", 3.5, 0, -3 * 3.5 / 2500, 2 * 3.5 / 125000, start="sOffset")
    first = section(lane(1, predecessor=None), lane(-1, successor=-1), lane(-2, width=width))
    second = section(lane(1, successor=None), lane(-1, predecessor=-1), s=50)
    assert "1.0.-2 > 1.1.-1" in _links(_map(road("1", first, second)))


def test_lane_that_begins_with_its_full_width_stays_loose():
    assert "1.0.-1 > 1.1.-2" not in _links(_with_pocket(cubic("width", 3.5, start="sOffset")))
