"""Stored programs: the same results from a file as from the compiler; a file of another program is never taken."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn import stored_program
from scjax.nn.stored_program import StoredProgram
from scjax.scene.per_type import PerType

BATCH = PerType(agents=np.arange(6.0, dtype=np.float32).reshape(2, 3), lanes=np.ones((2, 1), np.float32))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SCJAX_CACHE", str(tmp_path))
    return tmp_path / "executables"


def scaled(factor=2.0, options=("scaled", 2.0)):
    def scale(offset, batch: PerType) -> PerType:
        return jax.tree.map(lambda x: jnp.sin(factor * x) + offset, batch)

    return StoredProgram(scale, shared=1, options=options)


def expected(offset, factor=2.0):
    return jax.tree.map(lambda x: np.sin(factor * x) + offset, BATCH)


def stored(folder):
    """Number of executables; each has two names."""
    paths = list(folder.glob("*.program"))
    assert len(paths) == len(list(folder.iterdir()))
    return len({path.stat().st_ino for path in paths})


def check(program, offset=0.5, factor=2.0):
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5),
        program(np.float32(offset), BATCH),
        expected(offset, factor),
    )


def test_a_second_process_reads_what_the_first_one_compiled(folder, monkeypatch):
    check(scaled())
    assert stored(folder) == 1
    monkeypatch.setattr(StoredProgram, "_compile", None)
    check(scaled(), offset=-3.0)


def test_what_lies_in_the_cache_of_jax_is_compiled_again(folder, monkeypatch):
    """Executables that JAX reads from its own cache cannot be stored: their kernels are missing."""
    name = "jax_persistent_cache_min_compile_time_secs"
    before = jax.config.values[name]
    jax.config.update(name, 0.0)
    try:
        for _ in range(2):
            scaled().lower(np.float32(0.5), BATCH).compile()
        check(scaled())
    finally:
        jax.config.update(name, before)
    monkeypatch.setattr(StoredProgram, "_compile", None)
    check(scaled())


@pytest.mark.parametrize("change", ["options", "instruction set"])
def test_what_an_executable_depends_on_is_compiled_again(folder, monkeypatch, change):
    check(scaled())
    if change == "options":
        check(scaled(3.0, ("scaled", 3.0)), factor=3.0)
    else:
        monkeypatch.setattr(stored_program, "cpu_flags", lambda: "other")
        check(scaled())
    assert stored(folder) == 2


@pytest.mark.parametrize("factor", [2.0, 3.0])
def test_of_changed_source_other_programs_alone_are_compiled_again(folder, monkeypatch, factor):
    """The options are the same: the source alone makes another program, or the same."""
    check(scaled())
    monkeypatch.setattr(stored_program, "_source_digest", lambda: "other")
    if factor == 2.0:
        monkeypatch.setattr(StoredProgram, "_compile", None)
    check(scaled(factor), factor=factor)
    assert stored(folder) == (1 if factor == 2.0 else 2)
    monkeypatch.setattr(StoredProgram, "lower", None)
    check(scaled(factor), factor=factor)


def test_one_number_makes_another_program(folder, monkeypatch):
    """Of a long constant, too, which texts of programs may leave out."""
    for value in (0.0, 1.0):
        constant = np.zeros(10_000, np.float32)
        constant[5_000] = value

        def add(offset, batch: PerType, constant=constant) -> PerType:
            return jax.tree.map(lambda x: x + offset + jnp.asarray(constant).sum(), batch)

        monkeypatch.setattr(stored_program, "_source_digest", lambda value=value: str(value))
        result = StoredProgram(add, shared=1, options=("add",))(np.float32(0.5), BATCH)
        np.testing.assert_allclose(result.agents, BATCH.agents + 0.5 + value)
    assert stored(folder) == 2


def test_other_shapes_are_other_executables(folder):
    program = scaled()
    check(program)
    wide = PerType(agents=np.ones((2, 5), np.float32), lanes=BATCH.lanes)
    np.testing.assert_allclose(program(np.float32(0), wide).agents, np.sin(2 * wide.agents), rtol=1e-5)
    assert stored(folder) == 2


@pytest.mark.parametrize("content", [b"", b"cut off", "half"])
def test_a_damaged_file_is_made_again(folder, content):
    check(scaled())
    path, other = folder.glob("*.program")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if content == "half" else content)
    check(scaled())
    assert len(path.read_bytes()) > len(whole) // 2 and path.read_bytes() == other.read_bytes() and stored(folder) == 1


def test_without_a_folder_it_only_compiles(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("SCJAX_CACHE", str(tmp_path / "file"))
    check(scaled())


class Foreign:
    """A class that is not of scjax."""

    def __repr__(self):
        return "Foreign()"


@pytest.mark.parametrize("option", [Foreign(), check])
def test_what_depends_on_foreign_code_is_not_stored(folder, option):
    check(scaled(options=("scaled", ((option,),))))
    assert not folder.exists()


def test_the_oldest_files_are_removed(folder, monkeypatch):
    monkeypatch.setattr(stored_program, "_MAX_FILES", 2)
    for factor in (1.0, 2.0, 3.0):
        check(scaled(factor, (factor,)), factor=factor)
    assert stored(folder) == 2


def test_names_of_older_sources_are_removed(folder, monkeypatch):
    monkeypatch.setattr(stored_program, "_MAX_NAMES", 3)
    for version in range(6):
        monkeypatch.setattr(stored_program, "_source_digest", lambda version=version: str(version))
        check(scaled())
    assert stored(folder) == 1 and len(list(folder.iterdir())) <= 4
    monkeypatch.setattr(StoredProgram, "lower", None)
    check(scaled())
