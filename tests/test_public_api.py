"""The names of ``scjax`` and what importing them costs."""

from __future__ import annotations

import subprocess
import sys

import pytest

import scjax


def test_public_names_are_there():
    names = {"Scene", "Condition", "Stream", "load", "sample", "viz", "samplers", "Log", "crop_log", "Map", "crop_map"}
    assert names <= set(scjax.__all__)
    for name in scjax.__all__:
        assert getattr(scjax, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        scjax.nothing  # noqa: B018


def test_dir_lists_names_that_are_not_imported_yet():
    assert set(scjax.__all__) <= set(dir(scjax))


def test_viz_is_imported_when_it_is_used():
    code = "import sys, scjax; scjax.viz.grid; assert 'matplotlib' in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
