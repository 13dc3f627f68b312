"""Strict numerics for every test, and the shared folders that some of them need."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import json
import os
import platform
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jaxtyping
import pytest
from absl import flags
from filelock import FileLock

from tests.factories.type_checks import quick_jaxtyped

jaxtyping.jaxtyped = quick_jaxtyped  # before any module of scjax is read
flags.FLAGS.mark_as_parsed()  # grain reads absl flags even when nobody parsed any
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))  # as experiments.train does

# A jaxlib that does not know one of them stops at once and says so.
_QUICK = ("--xla_cpu_use_fusion_emitters=false", "--xla_cpu_parallel_codegen_split_count=1")
_KEEP_FREED = {"tcache_count": 60_000, "mxfast": 0, "trim_threshold": 4_000_000_000, "top_pad": 64 << 20}


def pytest_configure(config: pytest.Config) -> None:
    """Most of the suite's time is XLA compiling: all processes and checkouts share a cache, and optimise little.

    (The graph's own passes still run; what is left out are LLVM's, which take up to half of the time of a compilation.
    The older way to write loops for fused operations halves the rest. To cut a program into 32 modules, which threads
    compile side by side, takes a fifth of the compiler's time: workers keep all cores busy without it. Tracing leaves
    many objects behind: to look for garbage as often as Python does takes a tenth of the time. XLA allocates and frees
    small blocks all the time: with a glibc that keeps what is freed, workers take a tenth less.)
    """
    given = os.environ.get("XLA_FLAGS", "").split()
    os.environ["XLA_FLAGS"] = " ".join([*given, *(flag for flag in _QUICK if flag not in given)])
    gc.set_threshold(100_000, 20, 100)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # workers keep all cores busy
    tunables = ":".join(f"glibc.malloc.{name}={value}" for name, value in _KEEP_FREED.items())
    os.environ.setdefault("GLIBC_TUNABLES", tunables)  # for workers, which start after this, and child processes
    jax.config.update("jax_traceback_in_locations_limit", 0)  # else every operation gets the lines that called it
    os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
    jax.config.update("jax_disable_most_optimizations", os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] == "1")
    programs = _programs_folder(config)
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(programs / "jax"))
    os.environ.setdefault("SCJAX_CACHE", str(programs / "scjax"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
    jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


_MOST_SECONDS = 30 * 86_400
"""Age of programs in JAX's cache, after which they are compiled again: most are of tests that have changed."""


def _programs_folder(config: pytest.Config) -> Path:
    """Where compiled programs are kept, for all checkouts of a user: those that did not change are compiled once.

    One folder for each kind of processor, for homes that several machines share. ``SCJAX_TEST_CACHE`` names another.
    """
    given = os.environ.get("SCJAX_TEST_CACHE")
    root = Path(given or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "scjax-tests")
    cpus = Path("/proc/cpuinfo")
    lines = cpus.read_text().splitlines() if cpus.exists() else []
    flags = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    folder = root / hashlib.sha256(f"{platform.machine()} {flags}".encode()).hexdigest()[:12]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{os.getpid()}.probe").touch()
        (folder / f"{os.getpid()}.probe").unlink()
    except OSError:  # a home that cannot be written to: programs of this checkout alone
        return Path(str(config.cache.mkdir("programs")))  # pyright: ignore
    for path in (folder / "jax").glob("*"):
        with contextlib.suppress(FileNotFoundError):  # another process has removed it
            if path.stat().st_mtime < time.time() - _MOST_SECONDS:
                path.unlink()
    return folder


_MAX_MAPPINGS = 8_000
"""Pieces of memory of a process, after which its programs are dropped: then it holds about 4 GB."""


@pytest.fixture(scope="module", autouse=True)
def few_programs_in_memory():
    """Drops compiled programs between modules before there are too many for the process."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > _MAX_MAPPINGS:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(scope="session", autouse=True)
def every_program_is_stored():
    """The suite samples with more programs than the limit of users: at that limit, workers remove each other's."""
    from scjax.nn import stored_program

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stored_program, "_MAX_FILES", 1_500)
        yield


@pytest.fixture(scope="session", autouse=True)
def one_padded_size():
    """Scenes that tests sample are padded to one size: for every other one each model would be compiled once more."""
    from scjax.generate import batching

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batching, "BUCKETS", batching.BUCKETS[-1:])
        yield


_LONGEST = (
    "test_docs",
    "test_ablation",
    "test_train",
    "test_text_training",
    "test_sample",
    "test_picture_training",
    "test_image_training",
    "test_autoencoder",
    "test_gym_env",
    "test_denoiser",
    "test_image_and_request",
    "test_prompt_reader",
    "test_autoencoder_parity",
    "test_denoiser_cross_attention",
    "test_simulate",
    "test_encode",
    "test_eval_tiles",
    "test_route_follower",
    "test_stage_cross_attention",
    "test_train_parity",
    "test_samplers_study",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that take minutes come first: a worker that gets one last would finish it alone."""
    order = {name: place for place, name in enumerate(_LONGEST)}
    items.sort(key=lambda item: order.get(item.path.stem, len(order)))


_SHARED = Path(os.environ.get("SCJAX_SHARED", Path(__file__).resolve().parents[1] / ".." / "shared")).resolve()


def _folder(variable: str, name: str) -> Path:
    folder = Path(os.environ.get(variable, _SHARED / name))
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there: set {variable} or SCJAX_SHARED to run the tests on shared material")
    return folder


@pytest.fixture(scope="session")
def parity_dir() -> Path:
    """Golden vectors of the official model."""
    return _folder("SCJAX_PARITY_DIR", "parity")


@pytest.fixture(scope="session")
def eval_dir() -> Path:
    """Real tiles and golden metric values."""
    return _folder("SCJAX_EVAL_DIR", "eval")


@pytest.fixture(scope="session")
def golden_designs(eval_dir) -> dict[str, list]:
    """Worked examples of all golden metric files by name, as "match" and "obb"."""
    designs: dict[str, list] = {}
    for path in sorted(eval_dir.glob("golden_metrics*.json")):
        for name, cases in json.loads(path.read_text()).get("design", {}).items():
            if isinstance(cases, list):
                designs.setdefault(name, []).extend(cases)
    return designs


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Real recorded scenes."""
    return _folder("SCJAX_DATA_DIR", "data")


@pytest.fixture(scope="session")
def cases_dir() -> Path:
    """Inputs that failed when the project was tried as a user would."""
    return _folder("SCJAX_CASES_DIR", "cases")


def _build_once(tmp_path_factory: pytest.TempPathFactory, name: str, build: Callable[[Path], object]) -> Path:
    """A folder that the first worker to ask for it builds; all tests of this session read it, and none writes to it."""
    root = tmp_path_factory.getbasetemp()
    folder = (root.parent if "PYTEST_XDIST_WORKER" in os.environ else root) / name
    complete = folder.with_name(f"{name}.complete")
    with FileLock(f"{folder}.lock"):
        if not complete.exists():
            shutil.rmtree(folder, ignore_errors=True)
            build(folder)
            complete.touch()
    return folder


@pytest.fixture(scope="session")
def world_records(tmp_path_factory) -> Path:
    """Records of four synthetic worlds, with both splits; not to be written to."""
    from tests.factories.worlds import make_records

    return _build_once(tmp_path_factory, "worlds", make_records)


@pytest.fixture(scope="session")
def captioned_records(tmp_path_factory) -> Path:
    """Captioned, embedded (``Words``) and measured records with both splits; not to be written to."""
    from tests.factories.studies import save_captioned_records

    return _build_once(tmp_path_factory, "captioned", save_captioned_records)


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Runs a command of ``scjax`` in an empty folder: exit code, stdout, stderr."""
    from scjax.cli import main

    monkeypatch.setattr("scjax.nn.startup.start_jax", lambda: None)  # no cache folder, no other devices
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["scjax", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return int(stop.value.code or 0), out, err

    return call
