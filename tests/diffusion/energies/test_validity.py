"""Energies of open joints and overlapping boxes: none where a scene is sound, and downhill is better."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.energies.validity import connection_energy, energy, off_lane_energy, overlap_depth, overlap_energy
from scjax.scene import AgentType, Link, Scene, empty, pad, stack
from scjax.scene.boxes import overlaps


def road(gap=(0.0, 0.0)) -> Scene:
    """Two lanes of 20 m in a row to the east, the second one shifted."""
    scene = empty(0, 2)
    for i in range(2):
        scene.lanes[i, :, 0] = np.linspace(20 * i, 20 * i + 20, 20)
    scene.lanes[1, :, :2] += np.asarray(gap, np.float32)
    scene.links[:] = [[Link.SELF, Link.PREDECESSOR], [Link.SUCCESSOR, Link.SELF]]
    scene.lane_mask[:] = scene.lane_known[:] = True
    return scene


def cars(*places) -> Scene:
    """Boxes of 4 x 2 m at (x, y, heading [degrees])."""
    scene = empty(len(places), 0)
    for i, (x, y, heading) in enumerate(places):
        turn = np.deg2rad(heading)
        scene.agents[i] = (x, y, 0, 0, np.cos(turn), np.sin(turn), 4, 2, 1.5)
    scene.agent_mask[:] = scene.agent_known[:] = True
    return scene


def of(energy, scene: Scene, **options) -> float:
    return float(energy(stack([scene]), **options)[0])


def test_a_gap_costs_half_its_square():
    assert of(connection_energy, road()) == 0
    assert of(connection_energy, road((0.3, -0.4))) == pytest.approx(0.125, rel=0.01)
    assert of(connection_energy, road((30, 40))) == pytest.approx(5 * 50, rel=0.12), "wide gaps: 5 m times their length"
    assert of(connection_energy, road((3, 4)).replace(links=np.diag([Link.SELF, Link.SELF]).astype(np.int32))) == 0


@pytest.mark.parametrize(
    ("place", "depth"),
    [
        ((3, 0, 0), 1.0),  # bumpers
        ((0.5, 1.5, 0), 0.5),  # side by side
        ((2.5, 0, 90), 0.5),  # a T
        ((0, 0, 0), 2.0),  # one on the other: the width is the shortest way out
        ((6, 0, 180), -2.0),
    ],
)
def test_depth_is_the_shortest_way_out(place, depth):
    agents = stack([cars((0, 0, 0), place)]).agents
    found = np.asarray(overlap_depth(agents))[0]
    np.testing.assert_allclose([found[0, 1], found[1, 0]], depth, atol=1e-5)


def test_boxes_overlap_where_they_do_by_the_metric():
    rng = np.random.default_rng(0)
    places = np.concatenate([rng.uniform(-9, 9, (30, 2)), rng.uniform(-180, 180, (30, 1))], 1)
    scene = cars(*places)
    depth = np.array(overlap_depth(stack([scene]).agents))[0]
    np.fill_diagonal(depth, -1)
    assert np.array_equal(depth > 1e-5, overlaps(np.asarray(scene.agents)))
    pairs = np.argwhere(np.triu(depth > 0))
    expected = 0.5 * sum(depth[i, j] ** 2 for i, j in pairs)
    assert of(overlap_energy, scene, air=0.0) == pytest.approx(expected, rel=1e-5)
    assert of(overlap_energy, scene) > expected, "air counts as overlap"


def test_downhill_parts_boxes_and_closes_joints():
    scene = stack([cars((0, 0, 0), (3, 0.5, 10), (3.2, 1, 70))])
    slope = jax.grad(lambda a: overlap_energy(scene.replace(agents=a)).sum())
    agents = jnp.asarray(scene.agents)
    for _ in range(40):
        agents = agents - 0.4 * slope(agents)
    assert not overlaps(np.asarray(agents[0])).any()
    np.testing.assert_array_equal(agents[..., 2:], scene.agents[..., 2:])  # boxes neither turn nor shrink
    roads = stack([road((3, 4))])
    lanes = jnp.asarray(roads.lanes)
    for _ in range(40):
        lanes = lanes - 0.4 * jax.grad(lambda x: connection_energy(roads.replace(lanes=x)).sum())(lanes)
    assert float(jnp.abs(lanes[0, 0, -1] - lanes[0, 1, 0]).max()) < 1e-3


def test_strays_are_vehicles_farther_from_lanes_than_is_usual():
    """1 m from a lane when driving and 4 m when standing cost nothing; people and scenes without lanes neither."""
    scene = pad(road(), 2, 2)

    def at(y: float, speed: float, kind=AgentType.VEHICLE) -> float:
        generated = scene.replace(
            agents=np.zeros_like(scene.agents), agent_types=np.full_like(scene.agent_types, kind),
            agent_mask=np.array([True, False]),
        )  # fmt: skip
        generated.agents[:, :4] = (7, y, 0, speed)
        return of(off_lane_energy, generated)

    assert at(0.9, 5.0) == at(-3.9, 0.0) == at(3.0, 5.0, AgentType.PEDESTRIAN) == 0
    assert at(1.5, 5.0) == pytest.approx(0.125, rel=0.01) and at(-4.5, 0.0) == pytest.approx(0.125, rel=0.01)
    assert at(51.0, 5.0) == pytest.approx(5 * 50, rel=0.12), "far ones: 5 m times their way"
    assert of(off_lane_energy, cars((0, 9, 0))) == 0


def test_downhill_leads_a_stray_to_its_lane_and_leaves_the_lane():
    scene = stack([pad(road(), 1, 2).replace(agent_mask=np.array([True]))])
    agents = np.zeros_like(scene.agents)
    agents[0, 0, :4] = (7, -3, 0, 5)
    scene = scene.replace(agents=agents)
    places = jnp.asarray(agents)
    for _ in range(20):
        places = places - 0.4 * jax.grad(lambda a: off_lane_energy(scene.replace(agents=a)).sum())(places)
    np.testing.assert_allclose(places[0, 0, :2], (7, -1), atol=1e-2)
    assert not jax.grad(lambda x: off_lane_energy(scene.replace(lanes=x)).sum())(jnp.asarray(scene.lanes)).any()


def test_what_steers_is_their_sum():
    scene = pad(road((1, 0)), 2, 2)
    both = cars((0, 3, 0), (3, 3, 0)).replace(lanes=scene.lanes, links=scene.links, lane_mask=scene.lane_mask)
    both.agents[:, 3] = 9.0
    parts = [of(one, both) for one in (connection_energy, overlap_energy, off_lane_energy)]
    assert min(parts) > 0 and of(energy, both) == pytest.approx(parts[0] + parts[1] + 0.5 * parts[2], rel=1e-6)


def test_padding_costs_nothing_and_has_finite_gradients():
    for part, scene in (
        (connection_energy, road((1, 0))),
        (overlap_energy, cars((0, 0, 0), (3, 0, 0))),
        (energy, road((1, 0))),
    ):
        padded = pad(scene, 5, 6)
        assert of(part, padded) == pytest.approx(of(part, scene), rel=1e-6)
        batch = stack([padded])
        for name in ("agents", "lanes"):

            def total(x, name=name, part=part, batch=batch):
                return part(batch.replace(**{name: x})).sum()

            assert np.isfinite(jax.grad(total)(jnp.asarray(getattr(batch, name)))).all()
