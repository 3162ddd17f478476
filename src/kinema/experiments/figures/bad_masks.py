"""Draw who sees whom in BAD, as the paper's Figure 2 does: in training and at every step of OAAS.

`kinema figures bad_masks [--out reports/bad_masks]` writes bad_masks.png and bad_masks.txt.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Bool
from torch import Tensor

from kinema.atomic import replacing, write_text
from kinema.generators.bad.model import BAD
from kinema.generators.bad.sampling import BadSampling
from kinema.masking import SLOTS, hybrid_mask
from kinema.motion.view.draw import INK, MUTED, STAGE, new_figure
from kinema.types import Latents, TextFeatures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TOKENS, STEPS = 6, 4
PACE = round(STEPS * SLOTS / TOKENS)
"""Steps of a motion of the full length, so that a short one has `STEPS`."""
SEEN, SEEN_MASK, HIDDEN = "#2a6fe0", "#e2662a", "#e3e8ee"
LEGEND = ((SEEN, "sees it"), (SEEN_MASK, "sees it, a mask token"), (HIDDEN, "does not see it"))


@dataclass(frozen=True)
class Panel:
    """Hold one attention mask: row i may see column j where `visible`; `labels` name both, `masked` are mask tokens."""

    title: str
    labels: list[str]
    visible: Bool[Tensor, "m m"]
    masked: Bool[Tensor, " m"]


Rows = list[tuple[str, list[Panel]]]
"""Headed rows of panels."""


def panel(title: str, visible: Tensor, orders: Tensor, masked: Tensor, length: int) -> Panel:
    """Label a mask: S(entence), t(ime), positions (mask tokens by their order: M0, M1 ...), E(ND), P(AD)."""
    slots = [f"M{r}" if m else f"p{j}" for j, (r, m) in enumerate(zip(orders.tolist(), masked.tolist(), strict=True))]
    slots = [*slots[:length], "E", *["P"] * (len(slots) - length - 1)]
    ahead = len(visible) - len(slots)
    return Panel(title, [*"St"[:ahead], *slots], visible, torch.nn.functional.pad(masked, (ahead, 0)))


def worked_example() -> Panel:
    """Draw the example of four positions whose orders are 0, 1, 3, 2 and of which the last two are masked (BAD §3)."""
    orders, masked = torch.tensor([[0, 1, 3, 2, 4, 5]]), torch.tensor([[False, False, True, True, False, False]])
    visible = hybrid_mask(orders, masked, torch.tensor([4]), conditions=2)
    return panel("worked example", visible[0], orders[0], masked[0], 4)


def tiny_model() -> BAD:
    """Build an untrained model: who sees whom does not depend on weights."""
    torch.manual_seed(0)
    sizes: dict[str, Any] = {"width": 16, "heads": 2, "feedforward": 16}
    sizes |= {"cross_layers": 0, "base_layers": 1, "head_layers": 1}
    return BAD(codebook_size=32, code_dim=4, text_dim=8, token_dim=8, max_latents=TOKENS, **sizes)


def training(model: BAD, steps: int = 3) -> list[Panel]:
    """Record what the transformer is given in training steps."""
    panels, lengths = [], torch.tensor([TOKENS])
    latents = Latents(lengths, lengths * 4, codes=torch.arange(TOKENS)[None, :, None])
    text = TextFeatures([""], torch.zeros(1, 8))

    def record(module: torch.nn.Module, inputs: tuple[Any, ...], named: dict[str, Any]) -> None:
        ids, visible = inputs[0][0], named["mask"][0]
        masked, orders = ids >= model.first_mask, ids - model.first_mask
        panels.append(panel(f"{int(masked.sum())} of {TOKENS} masked", visible, orders, masked, TOKENS))

    hook = model.transformer.register_forward_pre_hook(record, with_kwargs=True)
    for seed in range(steps):
        model.loss(latents, text, generator=torch.Generator().manual_seed(seed))
    hook.remove()
    return panels


def oaas(model: BAD, official: bool) -> list[Panel]:
    """Record every step of OAAS; a batch of two, since the published sampler stops early for one."""
    text, seeds = TextFeatures(["", ""], torch.zeros(2, 8)), torch.tensor([0, 1])
    sampling = BadSampling(steps=PACE, official_inference_mask=official)
    panels, given = [], []
    hook = model.transformer.register_forward_pre_hook(lambda module, inputs: given.append(inputs[0][0]))
    frames = torch.tensor([4 * TOKENS, 4 * TOKENS])
    steps = model.trajectory(text, frames, seeds=seeds, sampling=sampling)
    for i, (_, visible, _) in enumerate(islice(steps, STEPS)):
        masked = given[-1] >= model.first_mask
        panels.append(panel(f"step {i + 1}", visible[0], given[-1] - model.first_mask, masked, TOKENS))
    hook.remove()
    return panels


def collect() -> Rows:
    """Make all masks of the figure by the code that trains and samples."""
    model = tiny_model()
    return [
        ("training", [worked_example(), *training(model)]),
        ("OAAS, mask of what is masked now (default)", oaas(model, official=False)),
        ("OAAS, mask of the published sampler (official_inference_mask)", oaas(model, official=True)),
    ]


def as_text(rows: Rows) -> str:
    """Write the masks as tables of 1 and 0."""
    blocks = ["Rows see columns. S sentence, t time, p0.. positions, M0.. mask tokens by their order, E END, P PAD."]
    for heading, panels in rows:
        for one in panels:
            lines = [f"{heading}: {one.title}", "   " + " ".join(f"{label:>2}" for label in one.labels)]
            for label, row in zip(one.labels, one.visible.int().tolist(), strict=True):
                lines.append(f"{label:<2} " + " ".join(f"{value:>2}" for value in row))
            blocks.append("\n".join(lines))
    return "\n\n".join(blocks) + "\n"


def draw(rows: Rows) -> Figure:
    """Draw the masks, a row of panels each."""
    columns = max(len(panels) for _, panels in rows)
    figure = new_figure(2.9 * columns, 3.35 * len(rows) + 0.45, dpi=150)
    grid = figure.add_gridspec(
        len(rows), columns, left=0.04, right=0.985, top=0.915, bottom=0.07, hspace=0.4, wspace=0.2
    )
    for i, (heading, panels) in enumerate(rows):
        for j, one in enumerate(panels):
            axes = figure.add_subplot(grid[i, j])
            _draw_panel(axes, one)
            if j == 0:
                axes.text(-0.05, 1.2, heading, transform=axes.transAxes, color=INK, fontsize=11, weight="bold")
    for k, (colour, label) in enumerate(LEGEND):
        figure.text(0.05 + 0.2 * k, 0.02, "■", color=colour, fontsize=13, va="center")
        figure.text(0.068 + 0.2 * k, 0.02, label, color=INK, fontsize=9, va="center")
    return figure


def _draw_panel(axes: Axes, one: Panel) -> None:
    from matplotlib.colors import ListedColormap

    kinds = torch.where(one.visible, 1 + one.masked.long()[None], 0)
    axes.pcolormesh(kinds.numpy(), cmap=ListedColormap([HIDDEN, SEEN, SEEN_MASK]), vmin=0, vmax=2, edgecolors=STAGE)
    axes.invert_yaxis()
    axes.set_aspect("equal")
    ticks = [i + 0.5 for i in range(len(one.labels))]
    axes.set_xticks(ticks, one.labels, fontsize=7, color=INK)
    axes.set_yticks(ticks, one.labels, fontsize=7, color=INK)
    axes.tick_params(length=0, top=False, labeltop=True, labelbottom=False, pad=1)
    axes.set_title(one.title, fontsize=8.5, color=MUTED, pad=4)
    for spine in axes.spines.values():
        spine.set_visible(False)


def write(out: Path) -> list[Path]:
    """Write the figure and its text version; raise ImportError without matplotlib."""
    rows = collect()
    text = write_text(out / "bad_masks.txt", as_text(rows))
    figure = draw(rows)
    with replacing(out / "bad_masks.png") as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})
    return [out / "bad_masks.png", text]


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line and draw."""
    parser = argparse.ArgumentParser(prog="kinema figures bad_masks", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("reports/bad_masks"), help="folder of the figure")
    options = parser.parse_args(arguments)
    try:
        for path in write(options.out):
            print(f"wrote     {path}")
    except (OSError, ImportError) as error:
        sys.exit(f"error: {error}")
