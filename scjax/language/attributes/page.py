"""The page of documentation that follows from the table.

python -m scjax.language.attributes.page docs/attributes.md
"""

from __future__ import annotations

import argparse
from pathlib import Path

from scjax.language.attributes.base import TAKES, UNSPECIFIED, Attribute
from scjax.language.attributes.table import ATTRIBUTES, GROUPS
from scjax.scene.files import write_text

_HEAD = f"""# Attributes

What can be measured on a scene: {len(ATTRIBUTES)} attributes. `scjax/language/attributes/` defines them, and
`python -m scjax.language.attributes.page docs/attributes.md` writes this page. Lengths are in meters, speeds in m/s.
The ego is agent 0 and counts as no vehicle.

```python
from scjax.language.attributes.table import measure_attributes, score_attributes
from scjax.scene.scene import empty

scene = empty(1, 0)
measure_attributes(scene)["vehicles"]
score = score_attributes(scene, {{"layout": "T", "vehicles": (3, 5), "signal": "{UNSPECIFIED}"}})
score.share, score.misses
```

A request names attributes; a missing one, None and "{UNSPECIFIED}" ask nothing. Each kind of attribute takes a form:

| kind | a request is |
| --- | --- |
"""
_TAIL = """
`scjax attributes FILE` prints all of them for the scenes in a file, `--ask JSON` compares them with a request. In
Python, `scjax.Condition(attributes=...)` takes a request: a text made of it stands in for a missing prompt, numbers of
vehicles set the number of agents, and `best_of` chooses by it.

Stop signs, yield signs and crosswalks are no attributes: scenes do not record them.
"""


def attributes_page() -> str:
    """The text of docs/attributes.md."""
    kinds = "".join(f"| {kind} | {form} |\n" for kind, form in TAKES.items())
    groups = "".join(
        f"\n## {title}\n\n| name | kind | values | meaning |\n| --- | --- | --- | --- |\n"
        + "".join(f"| {item.name} | {item.kind} | {_values(item)} | {item.meaning} |\n" for item in group)
        for title, group in GROUPS.items()
    )
    return _HEAD + kinds + groups + _TAIL


def _values(item: Attribute) -> str:
    if item.kind == "range":
        low, high = item.limits
        return f"{low:g} to {high:g} {item.unit}".strip()
    return ", ".join(item.values) or "true, false"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m scjax.language.attributes.page", description=__doc__)
    parser.add_argument("page", type=Path, help="file to write")
    write_text(parser.parse_args().page, attributes_page())


if __name__ == "__main__":
    main()
