"""DINOv2, DINOv3 and Depth Anything against the transformers library, with every parameter drawn anew.

The fixtures of ``tests/data/vision`` hold what the library made of tiny networks; where the library is installed, it
computes them again, at more sizes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

from scjax.encoders.depth import DEPTH_NETWORKS
from scjax.encoders.image_network import compiled_network, load_network
from scjax.encoders.resize import antialias_matrix, bicubic_matrix, bilinear_matrix, resize_antialiased
from scjax.encoders.vision import IMAGE_NETWORKS
from tests.factories.vision_networks import NETWORK_MAKERS, randomize, reference

FIXTURES = Path(__file__).parents[1] / "data" / "vision"
TOLERANCE = dict.fromkeys(NETWORK_MAKERS, 2e-5) | {"depth_anything": 1e-4}
# 5 x 5 patches, as the table of positions; fewer; more, and not square; one patch.
SIZES = [(20, 20), (12, 20), (28, 44), (4, 4)]


def _ours(folder, pixels):
    loaded = load_network(folder, {**IMAGE_NETWORKS, **DEPTH_NETWORKS}, "float32")
    return np.asarray(compiled_network(loaded.network, loaded.config)(loaded.params, pixels))


def _assert_close(ours, theirs, tolerance):
    assert ours.shape == theirs.shape and theirs.std() > 0.01
    np.testing.assert_allclose(ours, theirs, rtol=tolerance, atol=tolerance * np.abs(theirs).max())


@pytest.mark.parametrize("name", list(NETWORK_MAKERS))
def test_parity_of_fixtures(name):
    arrays = safetensors.numpy.load_file(FIXTURES / name / "reference.safetensors")
    _assert_close(_ours(FIXTURES / name, arrays["pixels"]), arrays["expected"], TOLERANCE[name])


@pytest.mark.parametrize("name", list(NETWORK_MAKERS))
def test_fixtures_are_small(name):
    assert sum(path.stat().st_size for path in (FIXTURES / name).iterdir()) < 100_000


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch", reason="the parity extra (torch, transformers) is not installed")


@pytest.fixture(scope="module")
def transformers():
    return pytest.importorskip("transformers", reason="the parity extra (torch, transformers) is not installed")


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", list(NETWORK_MAKERS))
def test_parity_on_random_networks(name, size, tmp_path, torch, transformers):
    model = randomize(NETWORK_MAKERS[name](transformers), torch, seed=sum(size))
    model.save_pretrained(tmp_path)
    pixels = np.random.default_rng(1).normal(size=(2, *size, 3)).astype(np.float32)
    theirs = reference(model, pixels, torch)
    _assert_close(_ours(tmp_path, pixels), theirs, TOLERANCE[name])


@pytest.mark.filterwarnings("default")
def test_parity_of_metric_depth(tmp_path, torch, transformers):
    model = NETWORK_MAKERS["depth_anything"](transformers)
    config = model.config
    config.depth_estimation_type, config.max_depth = "metric", 80
    model = randomize(type(model)(config), torch)
    model.save_pretrained(tmp_path)
    pixels = np.random.default_rng(1).normal(size=(1, 12, 20, 3)).astype(np.float32)
    _assert_close(_ours(tmp_path, pixels), reference(model, pixels, torch), 1e-4)


@pytest.mark.parametrize(("size", "target"), [(37, 14), (37, 25), (5, 11), (4, 4), (3, 1)])
@pytest.mark.parametrize("kind", ["bicubic", "bilinear", "aligned", "bicubic antialiased", "bilinear antialiased"])
def test_resize_parity(kind, size, target, torch):
    image = np.random.default_rng(0).normal(size=(size, 7)).astype(np.float32)
    matrix = {
        "bicubic": lambda: bicubic_matrix(size, target),
        "bilinear": lambda: bilinear_matrix(size, target, align_corners=False),
        "aligned": lambda: bilinear_matrix(size, target, align_corners=True),
        "bicubic antialiased": lambda: antialias_matrix(size, target, "cubic"),
        "bilinear antialiased": lambda: antialias_matrix(size, target, "linear"),
    }[kind]()
    mode = "bilinear" if kind == "aligned" else kind.split()[0]
    theirs = torch.nn.functional.interpolate(
        torch.from_numpy(image)[None, None],
        size=(target, 7),
        mode=mode,
        align_corners=kind == "aligned",
        antialias="antialiased" in kind,
    )[0, 0].numpy()
    np.testing.assert_allclose(matrix @ image, theirs, atol=1e-5)


@pytest.mark.parametrize("kernel", ["linear", "cubic"])
def test_picture_resize_parity(kernel, torch):
    image = np.random.default_rng(0).integers(0, 256, (90, 160, 3)).astype(np.uint8)
    theirs = torch.nn.functional.interpolate(
        torch.from_numpy(image).permute(2, 0, 1)[None].float(),
        size=(28, 28),
        mode=f"bi{kernel}",
        antialias=True,
    )[0].permute(1, 2, 0)
    np.testing.assert_allclose(resize_antialiased(image, 28, 28, kernel), theirs.numpy(), atol=2e-3)
