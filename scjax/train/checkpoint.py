"""Training checkpoints: state, data position and resolved config, written by orbax in the background."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jax
import orbax.checkpoint as ocp

FORMAT = 3
"""Format of the items below and of what they hold. Others are refused: their random numbers would not continue."""


class Checkpoints:
    """The checkpoints of one run in ``folder``; a context manager that waits for the last write.

    Items: ``state`` (any PyTree of arrays, typed keys included), ``data`` (JSON: position of the input stream),
    ``config`` (JSON: the resolved config and data statistics).
    """

    def __init__(self, folder: Path, config: dict[str, Any], *, keep: int = 2):
        self._folder = folder.resolve()
        self._config = config
        self._manager = ocp.CheckpointManager(
            self._folder,
            item_names=("state", "data", "config"),
            options=ocp.CheckpointManagerOptions(
                max_to_keep=keep, create=True, enable_async_checkpointing=True, step_prefix="step"
            ),
            metadata={"format": FORMAT},
        )

    def __enter__(self) -> Checkpoints:
        return self

    def __exit__(self, *exception) -> None:
        self._manager.wait_until_finished()
        self._manager.close()

    @property
    def latest(self) -> int | None:
        """Step of the last finished checkpoint, None if there is none."""
        return self._manager.latest_step()

    def save(self, step: int, state: Any, data: dict[str, Any], *, wait: bool = False) -> None:
        """Starts writing; waits for the write before, and raises its errors."""
        if step == self.latest:
            return
        self._manager.save(
            step,
            args=ocp.args.Composite(
                state=ocp.args.StandardSave(jax.tree.map(_one_copy, state)),
                data=ocp.args.JsonSave(data),
                config=ocp.args.JsonSave(self._config),
            ),
        )
        if wait:
            self._manager.wait_until_finished()

    def restore(self, like: Any) -> tuple[Any, dict[str, Any]]:
        """(state, data position) of the last checkpoint; ``like`` has its shapes, dtypes and shardings.

        Raises:
          ValueError: if it was written by another format or under another config.
        """
        step = self.latest
        version = (self._manager.metadata().custom_metadata or {}).get("format", 1)
        if version != FORMAT:
            cure = "update scjax" if version > FORMAT else "start from an exported model with --config.init_from"
            raise ValueError(
                f"{self._folder} has checkpoint format {version}, this code reads {FORMAT}: {cure}, "
                "or choose another --workdir"
            )
        items = self._manager.restore(step, args=ocp.args.Composite(config=ocp.args.JsonRestore()))
        saved, current = (_network_fields(json.loads(json.dumps(c))) for c in (items["config"], self._config))
        if saved != current:
            changed = sorted(key for key in {*saved, *current} if saved.get(key) != current.get(key))
            raise ValueError(
                f"{self._folder} holds a run with another config.model ({', '.join(changed)} differ): "
                "give its values, or another --workdir"
            )
        target = jax.tree.map(ocp.utils.to_shape_dtype_struct, like)
        items = self._manager.restore(
            step, args=ocp.args.Composite(state=ocp.args.StandardRestore(target), data=ocp.args.JsonRestore())
        )
        return items["state"], items["data"]


def _one_copy(leaf: Any) -> Any:
    """The leaf on one device, if every device has all of it: orbax would cut it up, by one program per shape.

    This makes no copy: JAX does not overwrite a donated buffer that is still read.
    """
    if isinstance(leaf, jax.Array) and leaf.is_fully_replicated and jax.process_count() == 1:
        return leaf.addressable_shards[0].data
    return leaf


def _network_fields(config: dict[str, Any]) -> dict[str, Any]:
    """The fields of a resolved config that decide what the parameters mean."""
    return {
        **config["model"],
        **{name: config[name] for name in ("cross_attention", "cross_attention_options") if name in config},
    }
