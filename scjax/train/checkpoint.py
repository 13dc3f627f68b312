"""Training checkpoints: state, data position and resolved config, written by orbax in the background."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import re
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp

from scjax.nn.cpu.backend import on_cpu
from scjax.scene.document import parse_document
from scjax.train.resume import compare_runs
from scjax.train.thread_errors import collected_thread_errors

FORMAT = 3
"""Format of the items below and of what they hold. Others are refused: their random numbers would not continue."""

_REST = 0.2
"""Seconds in which other tasks of orbax end after one has failed."""

_FACTS = "checkpoint"
"""Key in the item ``config`` for what is not of the config: format, hashes of the inputs, checksums. Checkpoints from
before these facts have no such key."""


class OrbaxError(ValueError):
    """A checkpoint that could not be written or read.

    Other tasks of orbax may still run, fail and print: a command ends its process without waiting for them.
    """


class Checkpoints:
    """The checkpoints of one run in ``folder``; a context manager that waits for the last write.

    Items: ``state`` (any PyTree of arrays, typed keys included), ``data`` (JSON: position of the input stream),
    ``config`` (JSON: the resolved config, with the format, the hashes of the inputs and checksums of the other items).

    Args:
      config: resolved config of the run.
      inputs: name of an input -> hash of its content.
      keep: checkpoints that stay.

    Raises:
      OrbaxError: files of the folder are damaged, or it cannot be written to.
    """

    def __init__(self, folder: Path, config: dict[str, Any], inputs: Mapping[str, str] | None = None, *, keep: int = 2):
        self._folder = folder.resolve()
        self._config, self._inputs = config, dict(inputs or {})
        self._unfinished: int | None = None  # step of the checkpoint that is being written
        try:
            self._manager = ocp.CheckpointManager(
                self._folder,
                item_names=("state", "data", "config"),
                options=ocp.CheckpointManagerOptions(
                    max_to_keep=keep,
                    create=True,
                    enable_async_checkpointing=True,
                    step_prefix="step",
                    cleanup_tmp_directories=True,
                ),
                metadata={"format": FORMAT},
            )
        except OSError as error:
            raise OrbaxError(
                f"no checkpoints can be written in {self._folder} ({_short(error)}): when that is mended, give the "
                "same command again"
            ) from error
        except Exception as error:  # orbax raises nothing more precise
            raise OrbaxError(_damaged(self._folder, _latest_step(self._folder), error)) from error

    def __enter__(self) -> Checkpoints:
        return self

    def __exit__(self, *exception) -> None:
        try:
            self._wait()
        finally:
            with contextlib.suppress(Exception):  # all is written, or the error above says why not
                self._manager.close()

    @property
    def latest(self) -> int | None:
        """Step of the last finished checkpoint, None if there is none."""
        return self._manager.latest_step()

    def save(self, step: int, state: Any, data: dict[str, Any], *, wait: bool = False) -> None:
        """Starts writing, after the write before has ended.

        Args:
          wait: return when the checkpoint is complete.

        Raises:
          OrbaxError: this checkpoint, or the one before it, could not be written.
        """
        self._wait()
        if step == self.latest:
            return
        facts = {
            "format": FORMAT,
            "inputs": self._inputs,
            "state": _checksum(jax.tree.leaves(state)),
            "data": _text_checksum(data),
        }
        items = ocp.args.Composite(
            state=ocp.args.StandardSave(jax.tree.map(_one_copy, state)),
            data=ocp.args.JsonSave(data),
            config=ocp.args.JsonSave({**self._config, _FACTS: facts}),
        )
        with self._write_errors(step):
            self._manager.save(step, args=items)
        self._unfinished = step
        if wait:
            self._wait()

    def _wait(self) -> None:
        """Waits until the checkpoint that is being written is complete."""
        step, self._unfinished = self._unfinished, None
        if step is None:
            return
        with self._write_errors(step):
            self._manager.wait_until_finished()
            if jax.process_index() == 0 and not (self._folder / f"step_{step}").is_dir():
                raise FileNotFoundError("it did not get its name")

    @contextlib.contextmanager
    def _write_errors(self, step: int) -> Iterator[None]:
        """Within it, every error says that the checkpoint of ``step`` could not be written."""
        try:
            yield
        except Exception as error:  # orbax raises nothing more precise
            latest = _latest_step(self._folder)
            start = "begins anew" if latest is None else f"continues from step {latest}"
            raise OrbaxError(
                f"the checkpoint of step {step} could not be written in {self._folder} ({_write_reason(error)}): when "
                f"that is mended, the same command {start}"
            ) from error

    def restore(self, like: Any) -> tuple[Any, dict[str, Any]]:
        """(state, data position) of the last checkpoint; ``like`` has its shapes, dtypes and shardings.

        Raises:
          ValueError: it was written by another format or under another config, its inputs had another content, or it is
            damaged.
        """
        step = self.latest
        facts = check_resume(self._folder, self._config, self._inputs)
        target = jax.tree.map(ocp.utils.to_shape_dtype_struct, like)
        reason = ""
        with collected_thread_errors():  # of the other tasks of orbax, after one has failed
            try:
                items = self._manager.restore(
                    step, args=ocp.args.Composite(state=ocp.args.StandardRestore(target), data=ocp.args.JsonRestore())
                )
            except Exception as error:  # orbax raises nothing more precise
                reason = str(error) or type(error).__name__
                time.sleep(_REST)
            if reason:
                gc.collect()  # takes up to a second, and without a failure there is nothing to collect
        if reason:
            raise OrbaxError(_damaged(self._folder, step, reason))
        state, data = items["state"], items["data"]
        for name, checksum in (("state", _checksum(jax.tree.leaves(state))), ("data", _text_checksum(data))):
            if facts.get(name, checksum) != checksum:
                raise ValueError(_damaged(self._folder, step, f"its {name} has another checksum than was recorded"))
        return state, data

    def use_position(self, restore: Callable[[dict[str, Any]], None], position: dict[str, Any]) -> None:
        """Calls ``restore`` with the data position of the last checkpoint.

        Raises:
          ValueError: the position is of another form, i.e. damaged.
        """
        try:
            restore(position)
        except (AttributeError, IndexError, KeyError, OverflowError, TypeError) as error:
            raise ValueError(_damaged(self._folder, self.latest, f"its data position is {position!r}")) from error


def check_resume(folder: Path, config: Mapping[str, Any], inputs: Mapping[str, str]) -> dict[str, Any]:
    """Compares a command with the run whose checkpoints ``folder`` holds, if any; only reads.

    Returns:
      What the last checkpoint says about itself.

    Raises:
      ValueError: that run has another format, fields that shape it differ, its inputs had another content, or the
        checkpoint is damaged.
    """
    step = _latest_step(folder)
    if step is None:
        return {}
    path = folder / f"step_{step}" / "config" / "metadata"
    cure = _cure(folder, step)
    try:
        saved = parse_document(path.read_bytes(), dict, path, cure)
    except OSError as error:
        raise ValueError(_damaged(folder, step, error)) from error
    facts = saved.pop(_FACTS, {})
    if not isinstance(facts, dict):
        raise ValueError(_damaged(folder, step, f"{path} has no facts"))
    version = facts.get("format")
    if version is None:
        version = _root_format(folder, step)
    if not isinstance(version, int) or version != FORMAT:
        is_newer = isinstance(version, int) and version > FORMAT
        advice = "update scjax" if is_newer else "start from an exported model with --config.init_from"
        raise ValueError(
            f"{folder} has checkpoint format {version}, this code reads {FORMAT}: {advice}, or choose another --workdir"
        )
    saved_inputs = facts.get("inputs")
    plain = json.loads(json.dumps(config))
    differences = compare_runs(saved, saved_inputs if isinstance(saved_inputs, dict) else None, plain, inputs)
    if differences:
        raise ValueError(f"{folder} holds another run: {'; '.join(differences)}. Give its values, or another --workdir")
    return facts


def _latest_step(folder: Path) -> int | None:
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    return max((int(match[1]) for name in names if (match := re.fullmatch(r"step_(\d+)", name))), default=None)


def _root_format(folder: Path, step: int) -> Any:
    """The format of checkpoints from before ``_FACTS``, which orbax keeps for the whole folder."""
    path = folder / "metadata" / "_ROOT_METADATA"
    try:
        content = parse_document(path.read_bytes(), dict, path, _cure(folder, step))
    except FileNotFoundError:
        return 1
    except OSError as error:
        raise ValueError(_damaged(folder, step, error)) from error
    custom = content.get("custom_metadata")
    return custom.get("format", 1) if isinstance(custom, dict) else 1


def _cure(folder: Path, step: int | None) -> str:
    return f"delete {folder / f'step_{step}'}: the checkpoint before is taken, or the run begins anew"


def _damaged(folder: Path, step: int | None, reason: object) -> str:
    return f"the checkpoint of step {step} in {folder} is damaged ({_short(reason)}): {_cure(folder, step)}"


def _write_reason(error: Exception) -> str:
    """Why a file could not be written. Tensorstore gives the error of the system as a number in a long text."""
    number = re.search(r"os_error_code='(\d+)'", str(error))
    return os.strerror(int(number[1])) if number else _short(error)


def _short(reason: object) -> str:
    text = " ".join(str(reason).split())
    return text if len(text) <= 200 else f"{text[:197]}..."


def _checksum(leaves: list[Any]) -> int:
    """The sum of the bits of all numbers, modulo 2^32; it does not depend on how they are sharded."""
    if on_cpu() and jax.process_count() == 1:  # at once, while its program would be compiled for seconds
        total = 0
        for leaf in leaves:
            total = (31 * total + int(_bits(leaf, np).sum(dtype=np.uint32))) % 2**32
        return total
    return int(_device_checksum(leaves))


@jax.jit
def _device_checksum(leaves: list[Any]) -> jax.Array:
    total = jnp.zeros((), jnp.uint32)
    for leaf in leaves:
        total = 31 * total + jnp.sum(_bits(leaf, jnp), dtype=jnp.uint32)
    return total


def _bits(leaf: Any, library: Any) -> Any:
    """The numbers of a leaf as uint32, by NumPy or ``jax.numpy``."""
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        leaf = jax.random.key_data(leaf)
    numbers = library.asarray(leaf)
    if numbers.dtype == bool:
        numbers = numbers.astype(np.uint8)
    return numbers.view(f"uint{8 * numbers.dtype.itemsize}").astype(np.uint32)


def _text_checksum(content: Any) -> int:
    return zlib.crc32(json.dumps(content, sort_keys=True).encode())


def _one_copy(leaf: Any) -> Any:
    """The leaf on one device, if every device has all of it: orbax would cut it up, by one program per shape.

    This makes no copy: JAX does not overwrite a donated buffer that is still read.
    """
    if isinstance(leaf, jax.Array) and leaf.is_fully_replicated and jax.process_count() == 1:
        return leaf.addressable_shards[0].data
    return leaf
