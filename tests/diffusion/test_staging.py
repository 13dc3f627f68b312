"""Staging: whoever follows the cues makes the event that the captioner reads; nobody else is touched."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.data.captions.facts import LIGHTS, parse
from scjax.diffusion.staging import EVENTS, Wanted, anything, cues, energy, wanted
from scjax.scene import AgentType, Link, Scene, empty, pad, stack

LANES = (0.0, 3.5, 7.0)  # m to the left of the ego; the last one leads the other way


def street(seed: int, *, vehicles: int = 9, walkers: int = 2) -> Scene:
    """Two lanes ahead and one back, 64 m long, and agents anywhere on and beside them; the ego is at the origin."""
    rng = np.random.default_rng(seed)
    scene = empty(1 + vehicles + walkers, len(LANES))
    for i, y in enumerate(LANES):
        x = np.linspace(-32, 32, 20)
        scene.lanes[i, :, 0], scene.lanes[i, :, 1] = (x if i < 2 else -x), y
        scene.links[i, i] = Link.SELF
    number = len(scene.agents)
    turn = rng.choice([0.0, 0.0, np.pi], number) + rng.normal(0, 0.1, number)
    turn[0] = 0.0
    scene.agents[:, 0], scene.agents[:, 1] = rng.uniform(-30, 30, number), rng.uniform(-5, 9, number)
    scene.agents[0, :2] = 0.0
    scene.agents[:, 3] = rng.uniform(0, 8, number)
    scene.agents[:, 4], scene.agents[:, 5] = np.cos(turn), np.sin(turn)
    scene.agents[:, 6:] = (4.5, 1.9, 1.6)
    scene.agents[1 + vehicles :, 6:] = (0.6, 0.6, 1.7)
    scene.agent_types[1 + vehicles :] = AgentType.PEDESTRIAN
    for name in ("agent_mask", "agent_known", "lane_mask", "lane_known"):
        getattr(scene, name)[:] = True
    return scene


def junction() -> Scene:
    """The ego's lane forks ahead into a way straight on and a turn to the left."""
    scene = empty(1, 3)
    scene.lanes[0, :, 0] = np.linspace(-20, 8, 20)
    scene.lanes[1, :, 0] = np.linspace(8, 30, 20)
    angle = np.linspace(0, np.pi / 2, 20)
    scene.lanes[2, :, 0], scene.lanes[2, :, 1] = 8 + 9 * np.sin(angle), 9 - 9 * np.cos(angle)
    scene.links[:] = np.diag([Link.SELF] * 3)
    for turn in (1, 2):
        scene.links[0, turn], scene.links[turn, 0] = Link.PREDECESSOR, Link.SUCCESSOR
    scene.agents[0, 4:] = (1, 0, 4.5, 1.9, 1.6)
    for name in ("agent_mask", "agent_known", "lane_mask", "lane_known"):
        getattr(scene, name)[:] = True
    return scene


def cues_of(scene: Scene, *events, light=None, made=None):
    """Those of a single scene, without its batch axis."""
    made = np.asarray(scene.agent_mask if made is None else made)
    found = cues(stack([scene]), wanted([(events, light)]), made[None])
    return jax.tree.map(lambda x: np.asarray(x)[0], found)


def followed(scene: Scene, poses) -> Scene:
    """With everybody where the cues want them."""
    agents = np.array(scene.agents)
    meant = poses.meant
    agents[meant, :2], agents[meant, 4:6] = poses.place[meant], poses.ahead[meant]
    speed = np.clip(agents[:, 3], poses.slowest, poses.fastest)
    agents[meant, 3] = np.maximum(speed, 0)[meant]
    return scene.replace(agents=agents)


@pytest.mark.parametrize("event", EVENTS)
def test_whoever_follows_the_cues_makes_the_event(event):
    """Whoever stands in a lane may have nobody before him: in dense traffic there is no place for that."""
    dense = event not in ("stopped vehicle in lane", "double parking")
    scenes = [street(seed, vehicles=9 if dense else 3, walkers=2 if dense else 0) for seed in range(12)]
    made = [followed(scene, cues_of(scene, event).poses) for scene in scenes]
    assert sum(event in parse(scene).events for scene in made) >= 11


@pytest.mark.parametrize("event", EVENTS)
def test_the_ego_and_given_agents_have_no_part(event):
    scene = street(3)
    free = np.arange(len(scene.agents)) % 2 == 0
    assert not cues_of(scene, event, made=free).poses.meant[~free | (np.arange(len(free)) == 0)].any()


def test_nobody_has_a_part_in_what_is_not_wanted_or_has_no_room():
    scene = street(0)
    assert not cues_of(scene).poses.meant.any()
    assert not cues_of(street(0, walkers=0), "jaywalker").poses.meant.any()
    assert not cues_of(street(0, vehicles=0), "wrong-way driver", "cut-in", "double parking").poses.meant.any()
    nowhere = scene.replace(lane_mask=np.zeros_like(scene.lane_mask))
    assert not any(cues_of(nowhere, event).poses.meant.any() for event in EVENTS)


def test_two_events_have_different_actors():
    scene = street(1)
    one, other = (cues_of(scene, event).poses.meant for event in ("wrong-way driver", "jaywalker"))
    assert (cues_of(scene, "wrong-way driver", "jaywalker").poses.meant == (one | other)).all()


@pytest.mark.parametrize("event", EVENTS)
def test_padding_changes_nothing(event):
    scene = street(5)
    small, large = cues_of(scene, event).poses, cues_of(pad(scene, 20, 9), event).poses
    number = len(scene.agents)
    assert small.meant.any() and not large.meant[number:].any()
    np.testing.assert_array_equal(small.meant, large.meant[:number])
    for name in ("place", "ahead", "slowest", "fastest"):
        np.testing.assert_allclose(
            getattr(small, name)[small.meant], getattr(large, name)[:number][small.meant], atol=1e-4
        )


@pytest.mark.parametrize("event", EVENTS)
def test_the_energy_is_none_where_the_cues_are_followed_and_falls_towards_them(event):
    scene = street(7)
    batch = stack([scene])
    found = cues(batch, wanted([((event,), None)]), batch.agent_mask)
    done = stack([followed(scene, jax.tree.map(lambda x: np.asarray(x)[0], found.poses))])
    start = float(energy(batch, None, found)[0])
    still = float(jnp.sum(jnp.square(jnp.minimum(done.agents[..., 3] - found.poses.fastest, 0.4)) * found.poses.meant))
    assert start > 1 and float(energy(done, None, found)[0]) <= still + 1e-3  # a speed below zero is never shown
    slope = jax.grad(lambda agents: energy(batch.replace(agents=agents), None, found).sum())(jnp.asarray(batch.agents))
    lower = energy(batch.replace(agents=batch.agents - 1e-4 * slope), None, found)
    assert np.isfinite(slope).all() and float(lower[0]) < start
    assert not np.asarray(slope)[0, ~np.asarray(found.poses.meant)[0]].any()


def test_who_faces_the_other_way_round_is_turned():
    """At the very opposite direction the distance on the circle has no slope."""
    scene = street(0, vehicles=1, walkers=0)
    scene.agents[1, :6] = (8, 0, 0, 6, 1, 0)
    scene.lane_mask[1:] = False  # there, along the ego, is the wrong way
    batch = stack([scene])
    found = cues(batch, wanted([(("wrong-way driver",), None)]), batch.agent_mask)
    slope = jax.grad(lambda agents: energy(batch.replace(agents=agents), None, found).sum())(jnp.asarray(batch.agents))
    assert np.abs(slope[0, 1, 4:6]).max() > 10


@pytest.mark.parametrize(("light", "before"), [("red", (0, 0, 0)), ("green", (0, 1, 3)), ("yellow", (0, 3, 0))])
def test_the_light_is_read_as_it_was_wanted(light, before):
    """No light yet, two that differ, or one alone."""
    scene = junction()
    scene.signals[:] = before
    shown = cues_of(scene, light=light).signals
    made = scene.replace(signals=np.where(shown > 0, shown, scene.signals).astype(np.int32))
    assert parse(made).signals == light
    assert not cues_of(scene).signals.any()


def test_lights_cost_what_their_logits_lack():
    batch = stack([junction()])
    found = cues(batch, wanted([((), "red")]), batch.agent_mask)
    logits = np.zeros((1, 3, 4), np.float32)
    level = float(energy(batch, logits, found)[0])
    logits[0, :, LIGHTS["red"]] = 20
    assert level == pytest.approx(2 * 100 * np.log(4), rel=1e-4) and float(energy(batch, logits, found)[0]) < 1e-3


def test_what_is_wanted():
    some = wanted([((), None), (("jaywalker",), None), ((), "green")])
    assert isinstance(some, Wanted) and np.asarray(anything(some)).tolist() == [False, True, True]
    assert some.events[1].nonzero()[0].tolist() == [EVENTS.index("jaywalker")]
