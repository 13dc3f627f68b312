"""Files of generated scenes, named by prompt, seed and number, and what is reported about them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from scjax.cli.output import slug, write_scene
from scjax.cli.prompt_lists import ListedPrompt

if TYPE_CHECKING:
    from scjax.scene import Scene


class SceneFiles(NamedTuple):
    """Where the scenes of a command go.

    Attributes:
      folder: for all scenes; those of an entry with an id are in a folder of that name in it.
      seed: of the command.
      num_scenes: scenes for each entry.
      formats: file endings.
    """

    folder: Path
    seed: int
    num_scenes: int
    formats: Sequence[str]

    def is_complete(self, entry: ListedPrompt) -> bool:
        """Whether all files of an entry with an id are there."""
        names = [self._name(entry, number) for number in range(self.num_scenes)]
        return all((self.folder / entry.id / f"{name}.{end}").is_file() for name in names for end in self.formats)

    def write(self, entries: Sequence[ListedPrompt], scenes: Sequence[Scene]) -> list[dict[str, Any]]:
        """Writes the scenes of the entries, entry by entry; one report for each."""
        results, numbers = [], Counter()
        for i, scene in enumerate(scenes):
            entry = entries[i // self.num_scenes]
            results.append(self._write_one(scene, entry, numbers[entry]))
            numbers[entry] += 1  # a prompt that is given twice has twice as many scenes
        return results

    def _write_one(self, scene: Scene, entry: ListedPrompt, number: int) -> dict[str, Any]:
        from scjax.language.facts import extract_facts

        folder = self.folder / entry.id
        folder.mkdir(exist_ok=True)
        files = write_scene(scene, folder, self._name(entry, number), self.formats)
        return {
            **({"id": entry.id} if entry.id else {}),
            "prompt": entry.prompt,
            "seed": self.seed,
            "number": number,
            "files": [str(path) for path in files],
            "lanes": int(scene.num_lanes),
            "agents": int(scene.num_agents),
            "facts": extract_facts(scene).to_json(),
        }

    def _name(self, entry: ListedPrompt, number: int) -> str:
        return f"{slug(entry.prompt)}-{self.seed}-{number}"
