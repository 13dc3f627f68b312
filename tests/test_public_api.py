"""The names of ``scjax`` and what importing them costs."""

from __future__ import annotations

import subprocess
import sys

import pytest

import scjax


def test_public_names_are_there():
    names = {"Scene", "Condition", "Stream", "load", "sample", "viz", "samplers", "Log", "crop_log"}
    assert names <= set(scjax.__all__)
    for name in scjax.__all__:
        assert getattr(scjax, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        scjax.nothing  # noqa: B018


def test_dir_lists_names_that_are_not_imported_yet():
    assert set(scjax.__all__) <= set(dir(scjax))


def _modules_after(code: str) -> set[str]:
    """Names of all modules that a new process has imported after running ``code``."""
    code += "; import sys; sys.stderr.write(' '.join(sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return set(result.stderr.split())


def test_viz_is_imported_when_it_is_used():
    assert "matplotlib" not in _modules_after("import scjax; scjax.sample; scjax.load")
    assert "matplotlib" in _modules_after("import scjax; scjax.viz.grid")


@pytest.mark.parametrize("words", ["['--help']", "['--version']"])
def test_help_needs_no_jax(words):
    modules = _modules_after(f"import scjax.cli; scjax.cli.cli.main({words}, standalone_mode=False)")
    assert "click" in modules and not {"jax", "numpy", "scipy", "flax", "matplotlib"} & modules


def test_sampling_imports_neither_scipy_nor_tokenizers():
    assert not {"scipy", "tokenizers"} & _modules_after("import scjax; scjax.sample; scjax.load")
