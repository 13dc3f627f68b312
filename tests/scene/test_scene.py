"""Scene: indexing, padding, stacking, and every complaint of validate."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from scjax.scene import Link, Scene, empty, pad, stack, validate
from tests.factories.examples import example_batch, example_scene


def test_validate_accepts_example_and_empty_scenes():
    for scene in (example_scene(), example_batch(), empty(0, 0), empty(3, 2)):
        assert validate(scene) is scene


def test_scene_counts_and_batch_shape():
    batch = stack([example_scene(agents=2, lanes=3), example_scene(agents=4, lanes=5)])
    assert batch.batch_shape == (2,)
    np.testing.assert_array_equal(batch.num_agents, [2, 4])
    np.testing.assert_array_equal(batch.num_lanes, [3, 5])


def test_scene_indexing():
    batch = example_batch(3)
    single, pair = batch[1], batch[1:]
    assert single.batch_shape == () and pair.batch_shape == (2,)
    for name, value in example_scene(1).to_dict().items():
        np.testing.assert_array_equal(getattr(single, name), value)
        np.testing.assert_array_equal(getattr(pair, name)[0], value)
    with pytest.raises(IndexError, match="single scene"):
        single[0]


def test_pad_keeps_content_and_adds_zeros():
    scene = example_scene(agents=3, lanes=4, padding=0)
    grown = validate(pad(scene, 6, 9))
    for name, value in scene.to_dict().items():
        inside = tuple(slice(0, n) for n in np.shape(value))
        np.testing.assert_array_equal(getattr(grown, name)[inside], value)
        outside = np.array(getattr(grown, name))
        if outside.ndim:
            outside[inside] = 0
            assert not outside.any(), name
    assert pad(example_batch(2), 8, 9).links.shape == (2, 9, 9)


@pytest.mark.parametrize("sizes", [(2, 10), (10, 2)])
def test_pad_refuses_smaller_sizes(sizes):
    with pytest.raises(ValueError, match="cannot pad a scene of 6 agent and 7 lane slots"):
        pad(example_scene(), *sizes)


def test_stack_with_slots_equals_padded_stack():
    scenes = [example_scene(agents=2, lanes=3), example_scene(agents=4, lanes=5)]
    batch, expected = stack(scenes, (6, 7)).to_dict(), stack([pad(scene, 6, 7) for scene in scenes]).to_dict()
    for name, array in expected.items():
        assert batch[name].dtype == array.dtype
        np.testing.assert_array_equal(batch[name], array)
    with pytest.raises(ValueError, match="up to 6 agent and 7 lane slots in 4 and 4"):
        stack(scenes, (4, 4))


def test_stack_refuses_empty_list():
    with pytest.raises(ValueError, match="empty list"):
        stack([])


def test_scene_is_a_pytree():
    batch = example_batch(2)
    doubled = jax.jit(lambda scene: jax.tree.map(lambda leaf: leaf, scene))(batch)
    assert isinstance(doubled, Scene) and isinstance(doubled.agents, jax.Array)
    assert isinstance(doubled.to_numpy().agents, np.ndarray)
    validate(doubled)
    mapped = jax.vmap(lambda scene: scene.agents.sum())(doubled)
    assert mapped.shape == (2,)


def test_validate_accepts_ring_of_two_lanes():
    scene = empty(0, 2)
    scene.lane_mask[:] = True
    scene.links[:] = [[Link.SELF, Link.PREDECESSOR], [Link.PREDECESSOR, Link.SELF]]
    validate(scene)


def _spoil(name, index, value):
    scene = example_scene()
    array = np.array(getattr(scene, name))
    array[index] = value
    return scene.replace(**{name: array})


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (lambda: example_scene().replace(signals=np.zeros(3, np.int32)), "signals has shape"),
        (lambda: example_scene().replace(links=np.zeros((5, 5), np.int32)), "links has shape"),
        (lambda: example_scene().replace(lanes=np.zeros((7, 20, 2), np.float32)), "lanes has shape"),
        (lambda: example_scene().replace(crop=np.zeros(2, np.int32)), "crop has shape"),
        (lambda: _spoil("agents", (1, 0), np.nan), r"agents\[1\] holds NaN"),
        (lambda: _spoil("lanes", (2, 4, 1), np.inf), r"lanes\[2\] holds NaN"),
        (lambda: _spoil("agents", (1, 8), 0), "0 m or less"),
        (lambda: _spoil("agents", (1, 4), 3), "not a unit vector"),
        (lambda: _spoil("agent_types", 0, 4), r"agent_types holds values outside 0..3: use values of AgentType"),
        (lambda: _spoil("signals", 0, -1), r"signals holds values outside 0..3: use values of Signal"),
        (lambda: _spoil("links", (0, 3), 6), r"links holds values outside 0..5: use values of Link"),
        (lambda: _spoil("crop", (), 3), r"crop holds values outside 0..2: use values of Crop"),
        (lambda: _spoil("links", (1, 1), Link.NONE), "SELF exactly on the diagonal"),
        (lambda: _spoil("links", (0, 3), Link.SELF), "SELF exactly on the diagonal"),
        (lambda: _spoil("links", (0, 3), Link.PREDECESSOR), "disagree"),
        (lambda: _spoil("links", (4, 3), Link.LEFT), "disagree"),
    ],
)
def test_validate_names_the_fault(broken, message):
    try:
        scene = broken()
    except Exception as error:  # the import hook may refuse a wrong shape before validate sees it
        assert "TypeCheckError" in type(error).__name__ or "Beartype" in type(error).__name__
        return
    with pytest.raises(ValueError, match=message):
        validate(scene)


def test_validate_ignores_padding():
    scene = _spoil("agents", (5, 0), np.nan)
    validate(scene)
