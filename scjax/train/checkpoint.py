"""Training checkpoints: state, data position and resolved config, written by orbax in the background."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jax
import orbax.checkpoint as ocp

FORMAT = 2  # of the items below and what they hold; a reader refuses others


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
        """Starts writing; at most one write is under way. Errors of the write before surface here."""
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
        """(state, data position) of the last checkpoint; ``like`` gives shapes, dtypes and shardings.

        Raises:
          ValueError: if it was written by another format or under another config.
        """
        step = self.latest
        written = (self._manager.metadata().custom_metadata or {}).get("format", 1)
        if written != FORMAT:
            cure = "update scjax" if written > FORMAT else "go on from an exported model with --config.start"
            raise ValueError(
                f"{self._folder} was written by checkpoint format {written}, this code reads {FORMAT}: {cure}, "
                "or choose another --workdir"
            )
        to_config = self._manager.restore(step, args=ocp.args.Composite(config=ocp.args.JsonRestore()))
        theirs, ours = (_shaping(json.loads(json.dumps(c))) for c in (to_config["config"], self._config))
        if theirs != ours:
            changed = sorted(key for key in {*theirs, *ours} if theirs.get(key) != ours.get(key))
            raise ValueError(
                f"{self._folder} holds a run with another config.model ({', '.join(changed)} differ): "
                "give its values, or another --workdir"
            )
        target = jax.tree.map(ocp.utils.to_shape_dtype_struct, like)
        loaded = self._manager.restore(
            step, args=ocp.args.Composite(state=ocp.args.StandardRestore(target), data=ocp.args.JsonRestore())
        )
        return loaded["state"], loaded["data"]


def _one_copy(leaf: Any) -> Any:
    """A leaf as it lies on one device, if every device has all of it: orbax would cut it up, a program a shape.

    No copy is made: JAX does not overwrite a donated buffer that somebody still reads.
    """
    if isinstance(leaf, jax.Array) and leaf.is_fully_replicated and jax.process_count() == 1:
        return leaf.addressable_shards[0].data
    return leaf


def _shaping(config: dict[str, Any]) -> dict[str, Any]:
    """The fields of a resolved config that decide what the parameters mean."""
    return {
        **config["model"],
        **{name: config[name] for name in ("cross_attention", "cross_attention_options") if name in config},
    }
