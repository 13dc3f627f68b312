"""Pictures of maps: what is drawn, by the names of the artists."""

from __future__ import annotations

import pytest

from scjax.scene import Map, MapTile, TileStatus
from scjax.viz import plot_map
from tests.factories.maps import two_tile_map


def test_plot_map_draws_tiles_seams_and_routes(tmp_path):
    axes = plot_map(two_tile_map(), title="two $tiles", path=tmp_path / "map.png")
    names = [artist.get_gid() for artist in axes.get_children() if artist.get_gid()]
    assert {"roads", "lanes", "arrows", "agents", "lights", "tile 0", "tile 1", "seam", "route"} <= set(names)
    legend = axes.get_legend()
    assert legend is not None
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["known tile", "incomplete tile", "vehicle", "light", "seam", "route"]
    assert (tmp_path / "map.png").stat().st_size > 1000


def test_plot_map_draws_a_tile_without_lanes():
    axes = plot_map(Map(lanes=(), tiles=(MapTile(x=0.0, y=0.0, status=TileStatus.MISSING),)))
    assert axes.get_xlim()[0] < -32


def test_plot_map_refuses_an_empty_map():
    with pytest.raises(ValueError, match="no lanes and no tiles"):
        plot_map(Map(lanes=()))
