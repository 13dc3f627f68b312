"""What a checkpoint holds while training goes on."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn.sharding import replicated
from scjax.train import checkpoint
from scjax.train.checkpoint import FORMAT, Checkpoints


def test_save_is_not_changed_by_later_donated_steps(tmp_path):
    step = jax.jit(lambda state: jax.tree.map(lambda x: x + 1, state), donate_argnums=0)
    state = replicated({str(n): jnp.full((300_000,), float(n)) for n in range(8)}, jax.device_count())
    with Checkpoints(tmp_path, {"model": {}}) as checkpoints:
        checkpoints.save(1, state, {"position": 3})
        for _ in range(4):
            state = step(state)
    with Checkpoints(tmp_path, {"model": {}}) as checkpoints:
        saved, data = checkpoints.restore(state)
    assert data == {"position": 3}
    for name, value in saved.items():
        np.testing.assert_array_equal(value, np.full(300_000, float(name), np.float32))
        assert value.sharding == state[name].sharding


@pytest.mark.parametrize("version, cure", [(FORMAT - 1, "--config.init_from"), (FORMAT + 1, "update scjax")])
def test_restore_of_another_format_names_the_cure(tmp_path, monkeypatch, version, cure):
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "FORMAT", version)
        with Checkpoints(tmp_path, {"model": {}}) as checkpoints:
            checkpoints.save(1, {"x": jnp.ones(2)}, {})
    with (
        Checkpoints(tmp_path, {"model": {}}) as checkpoints,
        pytest.raises(ValueError, match=f"format {version}.*{cure}"),
    ):
        checkpoints.restore({"x": jnp.ones(2)})


def test_checksum_of_the_host_is_that_of_devices():
    rng = np.random.default_rng(0)
    leaves = [
        replicated(jnp.asarray(rng.normal(size=(3, 5)), jnp.float32), jax.device_count()),
        jnp.asarray(rng.normal(size=3), jnp.bfloat16),
        jnp.asarray([True, False]),
        jax.random.key(5),
        jnp.int32(-7),
    ]
    checksum = checkpoint._checksum(leaves)
    assert checksum == int(checkpoint._device_checksum(leaves)) != checkpoint._checksum(leaves[::-1])
