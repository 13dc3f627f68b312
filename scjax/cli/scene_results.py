"""Files of generated scenes, named by prompt, seed and number, and what is reported about them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from scjax.cli.output import slug, write_scene
from scjax.cli.picture_input import PictureInput
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
      picture: that all scenes show, or None.
    """

    folder: Path
    seed: int
    num_scenes: int
    formats: Sequence[str]
    picture: PictureInput | None = None

    def is_complete(self, entry: ListedPrompt) -> bool:
        """Whether all files of an entry with an id are there."""
        names = [self._name(entry, number) for number in range(self.num_scenes)]
        return all((self.folder / entry.id / f"{name}.{end}").is_file() for name in names for end in self.formats)

    def write(
        self, entries: Sequence[ListedPrompt], requests: Sequence[Mapping[str, Any]], scenes: Sequence[Scene]
    ) -> list[dict[str, Any]]:
        """Writes the scenes of the entries, entry by entry; one report for each.

        Args:
          requests: attributes that were requested, for every entry.
        """
        results, numbers = [], Counter()
        for i, scene in enumerate(scenes):
            entry, request = entries[i // self.num_scenes], requests[i // self.num_scenes]
            results.append(self._write_one(scene, entry, numbers[entry]) | scene_report(scene, request))
            numbers[entry] += 1  # a prompt that is given twice has twice as many scenes
        return results

    def _write_one(self, scene: Scene, entry: ListedPrompt, number: int) -> dict[str, Any]:
        folder = self.folder / entry.id
        folder.mkdir(exist_ok=True)
        name = self._name(entry, number)
        files = write_scene(scene, folder, name, self.formats)
        if self.picture is not None:
            files.append(folder / f"{name}-view.png")
            self.picture.write_view(scene, files[-1])
        return {
            **({"id": entry.id} if entry.id else {}),
            **({"image": self.picture.photo.name} if self.picture is not None else {}),
            "prompt": entry.prompt,
            "seed": self.seed,
            "number": number,
            "files": [str(path) for path in files],
        }

    def _name(self, entry: ListedPrompt, number: int) -> str:
        words = [] if self.picture is None else [self.picture.name]
        words += [] if entry.prompt is None else [slug(entry.prompt)]
        return f"{'-'.join(words or ['scene'])}-{self.seed}-{number}"


def scene_report(scene: Scene, request: Mapping[str, Any]) -> dict[str, Any]:
    """Counts of a scene, what was requested of it, which parts of that it does not show, and all that it shows."""
    from scjax.language.attributes.table import measure_attributes, score_attributes

    return {
        "lanes": int(scene.num_lanes),
        "agents": int(scene.num_agents),
        "request": dict(request),
        "misses": list(score_attributes(scene, request).misses),
        "shows": measure_attributes(scene),
    }
