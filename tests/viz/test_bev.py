"""Figures: positions and colors of what is drawn, read from the matplotlib artists instead of pixels."""

from __future__ import annotations

import subprocess
import sys
import threading

import jax
import matplotlib.image
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from scjax import viz
from scjax.scene import AgentType, Crop, Link, Scene, Signal, empty
from scjax.scene.per_type import PerType
from scjax.viz.bev import AGENT_COLORS, EGO, KNOWN_ROAD, ROAD, SIGNAL_COLORS
from tests.factories.examples import example_batch, example_scene


def _scene() -> Scene:
    """Two straight lanes in a row along x, the second one red; an ego, a pedestrian turned left, a cone."""
    scene = empty(5, 4)
    scene.agents[:3, 4] = 1
    scene.agents[:3, 6:] = (4, 2, 1.5), (1, 0.8, 1.7), (0.4, 0.4, 0.8)
    scene.agents[:3, 0], scene.agents[0, 3] = (0, 10, 20), 5
    scene.agents[1, 4:6] = 0, 1
    scene.agent_types[:3] = AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.STATIC
    scene.agent_mask[:3], scene.lane_mask[:2] = True, True
    scene.lanes[:2, :, 0] = np.linspace(-20, 0, 20), np.linspace(1, 21, 20)
    scene.signals[1] = Signal.STOP
    scene.links[:2, :2] = [[Link.SELF, Link.PREDECESSOR], [Link.SUCCESSOR, Link.SELF]]
    return scene


def _artist(ax, gid):
    artists = [artist for artist in ax.collections if artist.get_gid() == gid]
    assert len(artists) == 1, gid
    return artists[0]


def _lines(ax, gid) -> list[np.ndarray]:
    return [path.vertices for path in _artist(ax, gid).get_paths()]


def _colors(ax, gid) -> list[str]:
    artist = _artist(ax, gid)
    return [to_hex(color) for color in (artist.get_edgecolor() if gid == "lanes" else artist.get_facecolor())]


def _legend_labels(figure):
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_lanes_have_signal_colors_and_connections():
    ax = viz.plot_scene(_scene(), title="two lanes")
    drawn = dict(zip(_colors(ax, "lanes"), _lines(ax, "lanes"), strict=True))
    np.testing.assert_allclose(drawn[SIGNAL_COLORS[Signal.STOP]][[0, -1]], [[1, 0], [21, 0]])
    np.testing.assert_allclose(drawn[SIGNAL_COLORS[Signal.UNKNOWN]][[0, -1]], [[-20, 0], [0, 0]])
    (connection,) = _lines(ax, "connections")
    np.testing.assert_allclose(connection, [[0, 0], [1, 0]])
    assert len(_artist(ax, "roads").get_paths()) == 2 and ax.get_title() == "two lanes"


def test_chevrons_point_in_driving_direction():
    scene = _scene()
    scene.lanes[1] = scene.lanes[1, ::-1]
    marks = _lines(viz.plot_scene(scene), "chevrons")
    assert len(marks) == 4  # 20 m each, one about every 9 m
    tips = [mark[1, 0] - mark[[0, 2], 0].mean() for mark in marks]
    assert all(tip > 0.5 for tip in tips[:2]) and all(tip < -0.5 for tip in tips[2:])


def test_boxes_have_type_colors_and_headings():
    ax = viz.plot_scene(_scene())
    boxes, colors = _lines(ax, "agents"), _colors(ax, "agents")
    assert colors == [AGENT_COLORS[AgentType.STATIC], AGENT_COLORS[AgentType.PEDESTRIAN], EGO]
    np.testing.assert_allclose([boxes[2].min(0), boxes[2].max(0)], [[-2, -1], [2, 1]])
    # The pedestrian faces left: its length lies along y.
    np.testing.assert_allclose([boxes[1].min(0), boxes[1].max(0)], [[9.6, -0.5], [10.4, 0.5]], atol=1e-6)
    ticks = _lines(ax, "headings")
    assert len(ticks) == 2  # a cone has no heading
    np.testing.assert_allclose(ticks[1], [[0, 0], [1.6, 0]], atol=1e-6)
    assert ticks[0][1, 1] > 0.5


def test_speeds_reach_one_second_ahead_of_the_nose():
    (arrow,) = _lines(viz.plot_scene(_scene(), speeds=True), "speeds")
    np.testing.assert_allclose(arrow[:2], [[2, 0], [7, 0]], atol=1e-6)


@pytest.mark.parametrize(("crop", "x_limits"), [(Crop.CENTERED, (-32, 32)), (Crop.FORWARD, (0, 64))])
def test_limits_and_aspect(crop, x_limits):
    ax = viz.plot_scene(_scene().replace(crop=np.asarray(crop, np.int32)))
    assert ax.get_xlim() == x_limits and ax.get_ylim() == (-32, 32)
    assert ax.get_aspect() == 1 and "m" in ax.get_xlabel()


def test_partitioned_scenes_show_the_partition_line():
    def cuts(crop):
        ax = viz.plot_scene(_scene().replace(crop=np.asarray(crop, np.int32)))
        return [line for line in ax.lines if list(line.get_xdata()) == [0, 0]]

    assert len(cuts(Crop.PARTITIONED)) == 1 and not cuts(Crop.CENTERED)


def test_known_elements_are_marked():
    scene = _scene()
    known = PerType(agents=np.array([True, *[False] * 4]), lanes=np.array([False, True, False, False]))
    ax = viz.plot_scene(scene, known=known)
    assert _colors(ax, "roads") == [ROAD, KNOWN_ROAD]
    (box,) = _lines(ax, "known")
    np.testing.assert_allclose(box.max(0), [2, 1])


def test_jax_arrays_and_existing_axes_are_accepted():
    ax = viz.plot_scene(jax.tree.map(jax.numpy.asarray, example_scene()))
    assert viz.plot_scene(empty(2, 3), ax=ax) is ax


def test_empty_scenes_draw_nothing():
    assert not viz.plot_scene(empty(0, 0)).collections


def test_batches_are_refused():
    with pytest.raises(ValueError, match="index it"):
        viz.plot_scene(example_batch(2))


def test_grid_writes_one_file_with_titles_and_legend(tmp_path):
    path = tmp_path / "new" / "grid.png"
    figure = viz.grid(example_batch(5), columns=3, titles=[f"scene {k}" for k in range(5)], path=path, dpi=40)
    assert [p.name for p in path.parent.iterdir()] == ["grid.png"]
    assert len(figure.axes) == 5 and [ax.get_title() for ax in figure.axes][4] == "scene 4"
    height, width = matplotlib.image.imread(path).shape[:2]
    assert (width, height) == tuple(int(n) for n in figure.get_size_inches() * 40)
    assert _legend_labels(figure)[0] == "ego" and "red light" in _legend_labels(figure)


def test_single_pictures_explain_the_colors_that_they_show():
    scene = _scene()
    figure = viz.plot_scene(scene).figure
    assert _legend_labels(figure) == ["ego", "pedestrian", "static", "lane", "red light"]
    scene.agent_mask[1:] = False
    scene.signals[:] = Signal.UNKNOWN
    assert _legend_labels(viz.plot_scene(scene).figure) == ["ego", "lane"]


def test_axes_of_others_get_no_legend():
    figure = Figure()
    viz.plot_scene(_scene(), ax=figure.add_subplot())
    assert not figure.legends


def test_grid_fills_rows_from_lists_and_masks():
    scenes = [_scene(), example_scene(), _scene()]
    masks = [PerType(agents=s.agent_mask, lanes=s.lane_mask) for s in scenes]
    figure = viz.grid(scenes, known=masks)
    boxes = [ax.get_position() for ax in figure.axes]
    assert len(boxes) == 3 and boxes[0].y0 == boxes[1].y0 > boxes[2].y1
    assert boxes[0].x0 == pytest.approx(boxes[2].x0) and boxes[0].x1 < boxes[1].x0


@pytest.mark.parametrize(
    ("scenes", "options", "message"),
    [
        ([], {}, "no scenes"),
        ([_scene()], {"titles": ["a", "b"]}, "2 titles for 1 scenes"),
        ([_scene()], {"known": []}, "0 known for 1 scenes"),
    ],
)
def test_grid_refuses_wrong_numbers(scenes, options, message):
    with pytest.raises(ValueError, match=message):
        viz.grid(scenes, **options)


def test_figures_are_drawn_in_threads():
    figures = []
    threads = [threading.Thread(target=lambda: figures.append(viz.grid([_scene()]))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(figures) == 2


def test_scjax_imports_no_matplotlib_and_viz_no_pyplot():
    check = "import sys, scjax, scjax.scene; assert 'matplotlib' not in sys.modules; import scjax.viz;"
    check += "assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", check], check=True)
