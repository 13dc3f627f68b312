"""Compiled programs that outlive the process: a second process neither traces nor compiles them.

An executable is stored with a key of all that it depends on: the program's options, the shapes and places of its
arguments, the source of this package, the versions of JAX, and the instruction set. A file that cannot be read is made
again. Where the source has changed, the program is traced and lowered, and its StableHLO is a second key: a program
that is still the same is not compiled again. (JAX's own compilation cache has that key alone: it always traces and
lowers, which take as long as running.)
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import inspect
import logging
import os
import pickle
import platform
import secrets
import tempfile
from collections.abc import Callable, Hashable, Iterable
from pathlib import Path
from typing import Any

import jax
from jax.experimental import serialize_executable
from jaxlib.version import __version__ as jaxlib_version

from scjax.nn.cpu.backend import cpu_flags, fast_compile_options
from scjax.nn.sharding import scene_mesh, spread
from scjax.nn.startup import cache_folder

_MAX_FILES = 128
"""Stored executables; the oldest ones are removed first. One is 0.2 to 2 MB."""

_MAX_NAMES = 8
"""Names of an executable: that of its StableHLO, and those of the versions of the source that make it."""

_CONFIG = ("jax_enable_x64", "jax_default_matmul_precision", "jax_disable_most_optimizations")

_log = logging.getLogger(__name__)


class StoredProgram:
    """A function of batches, compiled once for each shape, spread over devices, and stored in the cache folder."""

    def __init__(self, function: Callable[..., Any], *, shared: int, options: tuple[Any, ...], light: bool = False):
        """The program of a function.

        Args:
          function, shared: as for ``scjax.nn.sharding.spread``.
          options: all that the function closes over: values with a ``repr`` that tells them apart, and functions. With
            values of classes that are not of this package nothing is stored: their source may change unnoticed.
          light: as for ``fast_compile_options``.
        """
        self.name = function.__name__
        compiler_options = fast_compile_options(light=light)
        program = spread(function, shared=shared)
        self._token = secrets.token_hex(8)
        program.__name__ = f"{self.name}_{self._token}"  # a name that JAX's own cache never has, see ``_compile``
        self._jitted = jax.jit(program, compiler_options=compiler_options)
        self._shared = shared
        self._is_storable = _packages(options) <= {"builtins", "scjax", "numpy"}
        described = [option.__qualname__ if inspect.isfunction(option) else option for option in options]
        self._description = repr((self.name, shared, described, compiler_options))
        self._executables: dict[Hashable, Any] = {}

    def __call__(self, *arguments: Any) -> Any:
        leaves, structure = jax.tree.flatten(arguments)
        signature = structure, tuple(map(_signature, leaves))
        if signature not in self._executables:
            self._executables[signature] = self._load_or_compile(arguments, signature)
        return self._executables[signature](*arguments)

    def lower(self, *arguments: Any) -> Any:
        """The program for these arguments as StableHLO, not yet compiled."""
        return self._jitted.lower(*arguments)

    def _load_or_compile(self, arguments: tuple, signature: tuple) -> Any:
        if not self._is_storable:
            return self._compile(self.lower(*arguments))
        devices = scene_mesh(len(jax.tree.leaves(arguments[self._shared :])[0])).devices.ravel().tolist()
        place = self._description, str(signature), _environment(devices[0]), len(devices)
        path = cache_folder() / "executables" / f"{_digest(*place, _source_digest())}.program"
        executable = _load(path, arguments, devices)
        if executable is not None:
            return executable
        lowered = self.lower(*arguments)
        text = lowered.as_text().replace(self._token, "")
        of_text = path.with_name(f"{_digest(*place, text, str(lowered.out_tree))}.program")
        stored = _load(of_text, arguments, devices)
        executable = self._compile(lowered) if stored is None else stored
        try:
            if stored is None:
                data, _, structure = serialize_executable.serialize(executable)
                _write(of_text, pickle.dumps((data, jax.tree.unflatten(structure, range(structure.num_leaves)))))
            _link(path, of_text)
            _remove_oldest(path.parent)
        except (OSError, RuntimeError, ValueError) as error:  # it runs, but is compiled again in the next process
            _log.info("%s is not stored: %s", path, error)
        return executable

    def _compile(self, lowered: Any) -> Any:
        # An executable out of JAX's own cache cannot be stored: its kernels are missing. So none may be found there,
        # whoever compiled the same program before: its name is of this object alone. And none needs to be kept there.
        name = "jax_persistent_cache_min_compile_time_secs"
        before = jax.config.values[name]
        jax.config.update(name, float("inf"))
        try:
            return lowered.compile()
        finally:
            jax.config.update(name, before)


def _load(path: Path, arguments: tuple, devices: list[Any]) -> Any:
    """The executable in a file; None if there is none that can be read."""
    try:
        data, outputs = pickle.loads(path.read_bytes())
        inputs = jax.tree.structure((arguments, {}))
        executable = serialize_executable.deserialize_and_load(
            data, inputs, jax.tree.structure(outputs), execution_devices=devices
        )
        os.utime(path)  # used: it is among the last to be removed
        return executable
    except FileNotFoundError:
        return None
    except Exception as error:  # a file that was cut off, or is of another kind: it is made again
        _log.info("%s cannot be read (%s): it is compiled again", path, error)
        return None


def _signature(leaf: Any) -> tuple:
    """Shape, type and place of an argument; None for what lies on the first device of this process or on the host."""
    place = None
    if isinstance(leaf, jax.Array) and leaf.sharding.device_set != {jax.local_devices()[0]}:
        place = leaf.sharding
    return getattr(leaf, "shape", ()), getattr(leaf, "dtype", type(leaf)), place


def _packages(value: Any) -> set[str]:
    """The packages of the classes and functions that a value is made of."""
    parts: Iterable[Any] = ()
    if isinstance(value, tuple | list):
        parts = value
    elif isinstance(value, dict):
        parts = (*value.keys(), *value.values())
    elif dataclasses.is_dataclass(value):
        parts = [getattr(value, field.name) for field in dataclasses.fields(value)]
    module = value.__module__ if inspect.isfunction(value) else type(value).__module__
    return {module.partition(".")[0]}.union(*map(_packages, parts))


def _digest(*parts: Any) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:40]


def _environment(device: Any) -> str:
    """What an executable depends on besides its program, arguments and source."""
    return repr(
        (
            jax.__version__,
            jaxlib_version,
            device.platform,
            device.device_kind,
            device.client.platform_version,
            platform.machine(),
            sorted(cpu_flags()),
            os.environ.get("XLA_FLAGS", ""),
            [jax.config.values.get(name) for name in _CONFIG],
        )
    )


@functools.cache
def _source_digest() -> str:
    """A digest of this package's source."""
    folder = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def _write(path: Path, data: bytes) -> None:
    """Writes a whole file or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        try:
            file.write(data)
            file.close()
            os.replace(file.name, path)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise


def _link(path: Path, stored: Path) -> None:
    """Gives a stored executable the name ``path``, too."""
    if stored.stat().st_nlink > _MAX_NAMES:
        for other in path.parent.glob("*.program"):
            if other != stored and other.samefile(stored):
                other.unlink(missing_ok=True)
    temporary = path.with_suffix(f".{secrets.token_hex(8)}")
    try:
        os.link(stored, temporary)
        os.replace(temporary, path)
    except OSError:  # no hard links there
        _write(path, stored.read_bytes())
    finally:
        temporary.unlink(missing_ok=True)  # it stays where both names were of one file before


def _remove_oldest(folder: Path) -> None:
    """Leaves the ``_MAX_FILES`` executables that were used last."""
    last_use: dict[int, float] = {}
    names: dict[int, list[Path]] = {}
    for path in folder.glob("*.program"):
        with contextlib.suppress(FileNotFoundError):  # another process has removed it
            status = path.stat()
            last_use[status.st_ino] = status.st_mtime
            names.setdefault(status.st_ino, []).append(path)
    for file in sorted(names, key=last_use.__getitem__)[:-_MAX_FILES]:
        for path in names[file]:
            path.unlink(missing_ok=True)
