"""The page of documentation with example captions.

python -m scjax.language.grammar.page docs/captions.md
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from scjax.language.grammar.compose import Composition, compose_freely
from scjax.language.grammar.phrasebook import languages, phrasebook
from scjax.language.grammar.prompts import written_prompts
from scjax.language.grammar.styles import STYLES
from scjax.scene.files import write_text

_SEED = 44
_LENGTHS = (12, 160)  # characters of an example
_HEAD = """# Captions

Captions are composed from hand-written phrasings: {count} templates in {languages} languages, in
`scjax/language/grammar/phrases/`. Each comes with the request that its words make, in the form of
`Condition(attributes=...)` ([all attributes](attributes.md)). Vague words become generous ranges; an exact number of
four or more may be off by one. `scjax data caption RECORDS` writes captions of records.

Beside them {prompts} whole prompts were written by hand, in `scjax/language/grammar/prompts/`. They are about no scene:
the reader of prompts learns from them what people mean ([training](train.md)).

```python
import numpy as np

from scjax.language.attributes.table import measure_attributes
from scjax.language.grammar.compose import compose, compose_freely
from scjax.scene.scene import empty

rng = np.random.default_rng(0)
caption = compose(measure_attributes(empty(1, 0)), rng, style="everyday")  # what a scene shows
caption.text, caption.request
compose_freely(rng, language="en", contradicts=True).contradictions  # about no scene
```

Twenty examples about no scene, by `python -m scjax.language.grammar.page docs/captions.md`:

| style | language | text | request |
| --- | --- | --- | --- |
"""
_TAIL = """
To add a phrasing, add a line to a file of `phrases/`; to add a language, add a folder. `phrasebook.py` explains the
form of the files. To add a prompt, add a line to a file of `prompts/`: the text, a tab, its request as JSON.
"""


def captions_page() -> str:
    """The text of docs/captions.md."""
    rng = np.random.default_rng(_SEED)
    codes = languages()
    english = [name for name in STYLES if name != "languages"]
    pairs = [(name, "en") for name in (*english, "everyday", "variants")]
    others = codes[1:]
    pairs += [("languages", others[row % len(others)]) for row in range(20 - len(pairs))] if others else []
    rows = "".join(_row(_example(name, code, rng)) for name, code in pairs)
    count = sum(len(phrasebook(code).templates) for code in codes)
    return _HEAD.format(count=count, languages=len(codes), prompts=f"{len(written_prompts()):,}") + rows + _TAIL


def _example(style: str, language: str, rng: np.random.Generator) -> Composition:
    """A text of middle length with at least two attributes."""
    while True:
        composition = compose_freely(rng, style=style, language=language)
        is_short = _LENGTHS[0] <= len(composition.text) <= _LENGTHS[1]
        if is_short and len(composition.request) > 1 and "|" not in composition.text:
            return composition


def _row(composition: Composition) -> str:
    request = json.dumps(composition.request)
    return f"| {composition.style} | {composition.language} | {composition.text} | `{request}` |\n"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m scjax.language.grammar.page", description=__doc__)
    parser.add_argument("page", type=Path, help="file to write")
    write_text(parser.parse_args().page, captions_page())


if __name__ == "__main__":
    main()
