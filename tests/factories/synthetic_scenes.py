"""Synthetic worlds and their scenes."""

from __future__ import annotations

import functools
from collections.abc import Iterator

from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.local_map import simplify_graph
from scjax.data.records import make_record, sample_scene
from scjax.data.tiles import pose_of
from scjax.scene import Scene
from scjax.synthetic.recording import object_index, to_log
from scjax.synthetic.world import Ego, World, make_world

NUM_WORLDS = 30
SEED = 8


@functools.cache
def example_worlds() -> tuple[World, ...]:
    """The first worlds of one seed, the same objects at every call."""
    return tuple(make_world(SEED, k) for k in range(NUM_WORLDS))


def scenes_of(world: World) -> Iterator[tuple[Ego, Scene]]:
    """Every scene of a world with its ego."""
    log = to_log(world)
    graph = build_graph(log, split_at_signals=True, signals_alone=True, bends_alone=True)
    index, lanes = index_segments(graph), simplify_graph(graph)
    for ego in world.egos:
        pose = pose_of(log, index, ego.moment, object_index(world, ego.moment, ego.agent))
        yield ego, sample_scene(make_record(log, lanes, index, pose, 0)[0], off_road=True)
