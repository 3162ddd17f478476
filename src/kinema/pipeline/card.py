"""Say what a packed model is: method, corpus and licences, figures, and the commands that make it again."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from kinema.atomic import write_json, write_text
from kinema.files.json import Each, fault, read_json
from kinema.files.kinds import refuse

CARD, PAGE = "card.json", "README.md"
MOST = 1 << 20
FIX = "pack or download the model again"
KINDS = {
    "name": str,
    "method": str,
    "citation": str,
    "corpus": str,
    "motion": str,
    "licence": str,
    "sources": list,
    "text_encoder": str,
    "parameters": Each(int),
    "half": bool,
    "commands": list,
    "figures": list,
    "settings": dict,
    "versions": Each(str),
}
ROWS: dict[str, Any] = {
    "sources": {"source": str, "licence": str, "clips": int},
    "figures": {"split": str, "scores": Each(str), "command": str},
    "commands": str,
}
"""What each row of a list holds."""
UNKNOWN = "that of the corpus"
"""The licence of a model whose corpus names none."""


@dataclass(frozen=True)
class Card:
    """Hold what is known of a packed model.

    `motion` says what comes out; `sources` are {"source", "licence", "clips"}, `figures` {"split", "scores", "command"}
    with a text for each score; `settings` is the configuration that it was trained with, without paths; `parameters`
    counts the weights of each part.
    """

    name: str
    method: str
    corpus: str
    motion: str
    text_encoder: str
    parameters: dict[str, int]
    citation: str = ""
    licence: str = UNKNOWN
    half: bool = False
    sources: list[dict[str, Any]] = field(default_factory=list)
    commands: list[str] = field(default_factory=list)
    figures: list[dict[str, Any]] = field(default_factory=list)
    settings: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path) -> Card | None:
        """Read the card of a folder; None where it has none. Raises ValueError for one that is damaged."""
        file = folder / CARD
        if not file.is_file():
            return None
        found = read_json(file, KINDS, most=MOST, fix=FIX)
        for name, kind in ROWS.items():
            for row in found[name]:
                if wrong := fault(row, kind):
                    raise refuse(file, f"has {name!r}: a row {wrong}", FIX)
        return cls(**{key: found[key] for key in KINDS})

    def write(self, folder: Path) -> None:
        """Write the card as data, and as the page that people read."""
        write_json(folder / CARD, asdict(self))
        write_text(folder / PAGE, page(self))


def page(card: Card) -> str:
    """Write the card as Markdown with the head that the Hugging Face hub reads."""
    creative = card.licence.startswith("CC ")
    head = _HEAD.format(
        **asdict(card)
        | {
            "identifier": card.licence.lower().replace(" ", "-") if creative else "other",
            "source": card.citation or "no citation was given",
            "weights": ", ".join(f"{part} {count:,}" for part, count in card.parameters.items()),
            "precision": "half precision (single once loaded)" if card.half else "single precision",
        }
    )
    parts = (head, _sources(card), _LIMITS.format(name=card.name), _figures(card), _again(card))
    return "\n".join(part for part in parts if part)


_HEAD = """---
license: {identifier}
library_name: kinema
language: en
tags: [text-to-motion, human-motion, motion-generation]
---
# {name}

Makes human motion from an English sentence: {motion}.

| | |
|---|---|
| method | {method} |
| by | {source} |
| trained on | {corpus} |
| licence of the weights | {licence} |
| text encoder | {text_encoder} |
| parameters | {weights}, in {precision} |

## Use

```bash
kinema generate "a person waves with the left hand" --run {name} --out wave.html
kinema models {name}
```

```python
from kinema import TextToMotion

model = TextToMotion.from_pretrained("{name}")
(motion,) = model.generate("a person waves with the left hand", seed=1)
```

In place of `{name}` the folder that holds this page, or the name of its repository on the Hugging Face hub.
"""
_LIMITS = """## Limits

- It knows the actions and styles of its corpus (`kinema models {name}` lists them) and says so when a prompt is far
  from all of them; what it makes then is some motion, not what was asked for.
- One body of one size; no fingers, no face, no objects. Longer motions than its clips only by chaining.
- Generated feet slide more often than real ones do (`kinema export --lock-feet` holds them).
- It was not checked for any use in which a wrong motion does harm.
"""


def _sources(card: Card) -> str:
    lines = [f"| {one['source']} | {one['licence']} | {one['clips']} |" for one in card.sources]
    head = ["## Corpus and licences", "", "| source | licence | training clips |", "|---|---|---|"]
    last = "The weights are bound by these terms."
    return "\n".join([*head, *lines, "", last, ""]) if lines else ""


BESIDE = """\
Read them beside what real motion and the training clip of the nearest caption get on the same split (`source=real` and
`source=nearest` in place of `source=generation`): where a lookup does as well, they don't show that it generalises."""


def _figures(card: Card) -> str:
    found = ["## Figures", "", BESIDE, ""] if card.figures else []
    for one in card.figures:
        found += [f"On the {one['split']} split:", "", "| | |", "|---|---|"]
        found += [f"| {name} | {value} |" for name, value in one["scores"].items()]
        found += ["", "```bash", one["command"], "```", ""] if one["command"] else [""]
    return "\n".join(found)


def _again(card: Card) -> str:
    made = ", ".join(f"{name} {version}" for name, version in card.versions.items())
    commands = ["## Made by", "", "```bash", *card.commands, "```", ""] if card.commands else []
    return "\n".join([*commands, f"Trained with {made}.", ""]) if made else "\n".join(commands)
