"""OpenDRIVE files written by hand: roads, lanes and junctions as text."""

from __future__ import annotations

from pathlib import Path

from scjax.data.readers.xml_elements import Element, parse_elements

LINE = "<line/>"


def geometry(shape: str = LINE, length: float = 100.0, s: float = 0.0, x=0.0, y=0.0, heading=0.0) -> str:
    """A <geometry>."""
    return f'<geometry s="{s}" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry>'


def lane(
    number: int,
    lane_type: str = "driving",
    width: str | float = 3.5,
    predecessor: int | None = None,
    successor: int | None = None,
    more: str = "",
) -> str:
    """A <lane>; ``width`` is a number [m] or a text of <width> or <border> elements."""
    records = width if isinstance(width, str) else cubic("width", width, start="sOffset")
    before = "" if predecessor is None else f'<predecessor id="{predecessor}"/>'
    after = "" if successor is None else f'<successor id="{successor}"/>'
    link = f"<link>{before}{after}</link>" if before or after else ""
    return f'<lane id="{number}" type="{lane_type}" level="false" {more}>{link}{records}</lane>'


def cubic(tag: str, a: float = 0.0, b: float = 0.0, c: float = 0.0, d: float = 0.0, s: float = 0.0, start="s") -> str:
    """A record of a polynomial."""
    return f'<{tag} {start}="{s}" a="{a}" b="{b}" c="{c}" d="{d}"/>'


def section(*lanes: str, s: float = 0.0, more: str = "") -> str:
    """A <laneSection> of <lane> elements, sorted to the left and right by their ids."""
    numbers = [int(text.split('id="')[1].split('"')[0]) for text in lanes]
    left = "".join(text for text, number in zip(lanes, numbers, strict=True) if number > 0)
    right = "".join(text for text, number in zip(lanes, numbers, strict=True) if number < 0)
    sides = (f"<left>{left}</left>" if left else "") + '<center><lane id="0" type="none"/></center>'
    sides += f"<right>{right}</right>" if right else ""
    return f'<laneSection s="{s}" {more}>{sides}</laneSection>'


def road(
    number: str = "1",
    *sections: str,
    plan: str = "",
    length: float = 100.0,
    links: str = "",
    junction: str = "-1",
    elevation: str = "",
    lateral: str = "",
    offset: str = "",
    signals: str = "",
    more: str = "",
) -> str:
    """A <road>, by default straight from 0, 0 along x with one driving lane of 3.5 m on each side."""
    sections = sections or (section(lane(1), lane(-1)),)
    return (
        f'<road name="" id="{number}" length="{length}" junction="{junction}" {more}><link>{links}</link>'
        f"<planView>{plan or geometry(length=length)}</planView><elevationProfile>{elevation}</elevationProfile>"
        f"<lateralProfile>{lateral}</lateralProfile><lanes>{offset}{''.join(sections)}</lanes>"
        f"<signals>{signals}</signals></road>"
    )


def follows(tag: str, number: str, contact: str = "start") -> str:
    """The link of a road to another road."""
    return f'<{tag} elementType="road" elementId="{number}" contactPoint="{contact}"/>'


def leads_to(tag: str, junction: str) -> str:
    """The link of a road to a junction."""
    return f'<{tag} elementType="junction" elementId="{junction}"/>'


def document(*content: str) -> str:
    """An <OpenDRIVE> file."""
    return f'<?xml version="1.0"?>\n<OpenDRIVE><header revMajor="1" revMinor="6"/>{"".join(content)}</OpenDRIVE>'


def root(*content: str) -> Element:
    """The parsed root of ``document``."""
    return parse_elements(document(*content).encode())


def write_map(folder: Path, *content: str, name: str = "map.xodr") -> Path:
    """Writes ``document`` to a file."""
    path = folder / name
    path.write_text(document(*content), encoding="utf-8")
    return path


def fork() -> tuple[str, ...]:
    """A road that ends in junction 9, from where a way leads straight on and one to the left, each into a road.

    Road 1 runs along x from 0 to 100, road 2 from 120 on, road 3 along y from 110, 10. Ways 4 (straight) and 5 (a
    quarter of a circle of 10 m, drawn from its end) lie in the junction.
    """
    one_way = section(lane(-1, predecessor=-1, successor=-1))
    centered = cubic("laneOffset", 1.75)
    quarter = '<arc curvature="-0.1"/>'
    return (
        road("1", one_way, offset=centered, links=leads_to("successor", "9")),
        road("2", one_way, offset=centered, plan=geometry(x=120.0), links=leads_to("predecessor", "9")),
        road(
            "3",
            one_way,
            offset=centered,
            plan=geometry(x=110, y=10, heading=1.5707963267948966),
            links=leads_to("predecessor", "9"),
        ),
        road(
            "4",
            one_way,
            offset=centered,
            plan=geometry(x=100.0, length=20.0),
            length=20.0,
            junction="9",
            links=follows("predecessor", "1", "end") + follows("successor", "2"),
        ),
        road(
            "5",
            section(lane(1, predecessor=-1, successor=-1)),
            offset=cubic("laneOffset", -1.75),
            plan=geometry(quarter, 15.707963267948966, x=110.0, y=10.0, heading=-1.5707963267948966),
            length=15.707963267948966,
            junction="9",
            links=follows("predecessor", "3") + follows("successor", "1", "end"),
        ),
        '<junction id="9">'
        '<connection id="0" incomingRoad="1" connectingRoad="4" contactPoint="start"><laneLink from="-1" to="-1"/>'
        '</connection><connection id="1" incomingRoad="1" connectingRoad="5" contactPoint="end">'
        '<laneLink from="-1" to="1"/></connection></junction>',
    )
