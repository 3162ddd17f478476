"""Know which actions and styles a model was trained on, and say when a text is far from all of them."""

from __future__ import annotations

import json
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from safetensors.torch import save_file
from torch import Tensor

from kinema.atomic import replacing
from kinema.files.checkpoints import read_safetensors
from kinema.files.json import NUMBER, Each, parse_json
from kinema.files.kinds import refuse
from kinema.runs.console import printable
from kinema.types import TextFeatures

REPERTOIRE = "repertoire.safetensors"
FIX = "pack or download the model again"
HEADER = {"owners": list, "clips": Each(int), "styles": Each(int), "threshold": NUMBER}
NEAREST = 3


@dataclass(frozen=True)
class Repertoire:
    """Hold directions in a text encoder's space and the action that each stands for.

    `clips` and `styles` count the training clips of each action and style. A text whose cosine similarity to every
    direction is below `threshold` is far from all of them.
    """

    directions: Float[Tensor, "n c"]
    owners: list[str]
    clips: dict[str, int]
    styles: dict[str, int]
    threshold: float

    def similarities(self, pooled: Float[Tensor, "b c"]) -> Float[Tensor, "b n"]:
        """Return the cosine similarity of texts to each direction."""
        return unit(pooled.float().cpu()) @ unit(self.directions.float()).T

    def nearest(self, similarities: Float[Tensor, " n"]) -> list[str]:
        """Name the actions that are nearest, the nearest first."""
        order = similarities.argsort(descending=True).tolist()
        return list(dict.fromkeys(self.owners[i] for i in order))[:NEAREST]

    def tell(self, text: TextFeatures) -> None:
        """Warn once of texts that are far from all that is known; they are made all the same."""
        found = self.similarities(text.pooled)
        rows = dict(zip(text.texts, found, strict=True))
        far = [one for one, row in rows.items() if row.max() < self.threshold]
        if far:
            who = f"{far[0][:60]!r} is" if len(far) == 1 else f"{far[0][:60]!r} and {len(far) - 1} more texts are"
            nearest = printable("; ".join(self.nearest(rows[far[0]])))  # a downloaded file says what they are called
            warnings.warn(
                f"{who} far from all that this model was trained on; the nearest it knows: "
                f"{nearest} (`kinema models NAME` lists its actions and styles)",
                stacklevel=4,
            )

    def write(self, folder: Path) -> None:
        """Write it, directions in whole numbers up to 127: of 384 of them, none turns by more than a degree."""
        header = {"owners": self.owners, "clips": self.clips, "styles": self.styles, "threshold": self.threshold}
        with replacing(folder / REPERTOIRE) as temporary:
            save_file({"directions": _rounded(self.directions)}, temporary, metadata={"kinema": json.dumps(header)})

    @classmethod
    def read(cls, folder: Path) -> Repertoire | None:
        """Read the repertoire of a folder; None where it has none. Raises ValueError for one that is damaged."""
        file = folder / REPERTOIRE
        if not file.is_file():
            return None
        tensors, header = read_safetensors(file, "directions", fix=FIX)
        known = parse_json(header.get("kinema", ""), file, HEADER, fix=FIX)
        directions, owners = tensors["directions"].float(), [str(owner) for owner in known["owners"]]
        if directions.ndim != 2 or not len(directions) == len(owners) > 0 or not directions.isfinite().all():
            raise refuse(file, f"holds directions {tuple(directions.shape)} of {len(owners)} actions", FIX)
        return cls(directions, owners, known["clips"], known["styles"], float(known["threshold"]))


def unit(rows: Float[Tensor, "n c"]) -> Float[Tensor, "n c"]:
    """Bring rows to length 1."""
    return torch.nn.functional.normalize(rows, dim=-1)


def _rounded(rows: Tensor) -> Tensor:
    return (rows.float() / rows.abs().amax(-1, keepdim=True) * 127).round().to(torch.int8)


def threshold_between(own: Float[Tensor, " n"], foreign: Float[Tensor, " m"]) -> float:
    """Return the similarity below which texts are far: that of all but 3 % of foreign ones, and of 1 % of own at most.

    At the foreign end of the gap between both, since people write shorter than a corpus' captions.
    """
    return min(float(np.quantile(own.numpy(), 0.01)), float(np.quantile(foreign.numpy(), 0.97)))
