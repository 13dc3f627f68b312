"""The vision network of scjax: cells, tokens and depth, and its folders."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.encoders import load_depth_network, load_image_encoder
from scjax.encoders.dashcam_network import NUMBERS, DashcamConfig
from scjax.encoders.dashcam_weights import DashcamWeights, dashcam_functions

CONFIG = DashcamConfig(stem=8, fine=8, fine_layers=1, hidden_size=12, layers=1, heads=2, features=5, rows=4, columns=3)


@pytest.fixture(scope="module")
def apply():
    """The network, compiled: operation by operation it takes hundreds of programs."""
    return jax.jit(dashcam_functions(CONFIG).apply, static_argnames="method")


@pytest.fixture(scope="module")
def params():
    rng = np.random.default_rng(0)
    return jax.tree.map(
        lambda leaf: jnp.asarray(rng.normal(0, 0.3, leaf.shape), jnp.float32), dashcam_functions(CONFIG).shapes()
    )


@pytest.fixture(scope="module")
def pixels():
    return jnp.asarray(np.random.default_rng(1).normal(size=(3, 64, 48, 3)).astype(np.float32))


@pytest.fixture(scope="module")
def folder(tmp_path_factory, params):
    return DashcamWeights(CONFIG, params, {"steps": 3}).save(tmp_path_factory.mktemp("vision") / "model")


def test_network_gives_tokens_and_fine_cells(apply, params, pixels):
    tokens = apply(params, pixels)
    cells = apply(params, pixels, method="cells")
    assert tokens.shape == (3, 12, CONFIG.width)
    assert cells.classes.shape == (3, 8, 6, NUMBERS["classes"]) and cells.objects.shape == (3, 8, 6, 7)
    depth = apply(params, pixels, method="depth")
    np.testing.assert_allclose(depth, np.exp(cells.depth), rtol=1e-5)


def test_tokens_hold_the_numbers_of_their_fine_cells(apply, params, pixels):
    """The first number of a token after its features is the first class logit of its upper left fine cell."""
    tokens = np.asarray(apply(params, pixels)).reshape(3, 4, 3, -1)
    cells = apply(params, pixels, method="cells")
    np.testing.assert_allclose(tokens[..., CONFIG.features], cells.classes[:, ::2, ::2, 0], atol=1e-5)


def test_picture_alone_equals_in_a_batch(apply, params, pixels):
    batch = np.asarray(apply(params, pixels))
    np.testing.assert_allclose(batch[1:2], apply(params, pixels[1:2]), atol=2e-5)


def test_folder_loads_as_encoder_and_as_depth_network(folder, apply, params):
    picture = np.random.default_rng(2).integers(0, 256, (90, 160, 3)).astype(np.uint8)
    encoder = load_image_encoder(folder)
    assert encoder.width == CONFIG.width and encoder.name.startswith("scjax_dashcam-")
    from scjax.camera.photo import photo_from_array
    from scjax.encoders.preprocessing import Preprocessing, prepare_image

    grid = Preprocessing("own", 4, 3)
    (tokens,) = encoder([picture], grid)
    prepared = jnp.asarray(prepare_image(photo_from_array(picture), grid, CONFIG.patch_size).pixels)
    np.testing.assert_allclose(tokens.tokens, apply(params, prepared[None])[0], atol=2e-5)
    depth = load_depth_network(folder)(photo_from_array(picture))
    expected = apply(params, prepared[None], method="depth")[0]
    np.testing.assert_allclose(depth, expected, rtol=1e-4)


def test_folder_of_other_sizes_is_refused(folder, tmp_path):
    (tmp_path / "config.json").write_text((folder / "config.json").read_text().replace('"fine": 8', '"fine": 16'))
    (tmp_path / "model.safetensors").write_bytes((folder / "model.safetensors").read_bytes())
    with pytest.raises(ValueError, match=r"to_fine\.kernel is"):
        load_image_encoder(tmp_path)
