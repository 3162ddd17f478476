"""Load and write the published transformers of T2M-GPT and AttT2M (`net_best_fid.pth`, entry `trans`).

Both are one network, AttT2M has cross-attention in front; the keys tell which it is.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from kinema.generators.gpt.model import T2MGPT
from kinema.interop.checkpoint import count, require, transfer
from kinema.nn.embeddings import sinusoidal_positions

# Published name -> ours, of layers that hold a weight and a bias.
LAYERS = {
    "trans_base.cond_emb": "text_projection",
    "trans_base.word_emb": "word_projection",
    "trans_head.ln_f": "norm",
}
MATRICES = {"trans_base.tok_emb.weight": "token_embedding.weight", "trans_head.head.weight": "head.weight"}
BLOCK = {
    **{f"attn.{part}": f"attention.{part}" for part in ("query", "key", "value", "proj")},
    **{f"ln{i}": f"norm{i}" for i in (1, 2)},
    "mlp.0": "mlp.0",
    "mlp.2": "mlp.3",
}
CROSS_BLOCK = BLOCK | {"ln3": "norm3"}
POSITIONS = "trans_base.pos_embedding.weight"
LATENTS, FURTHER = 49, 2
"""The published number of latents, and the rows that the table of positions has beside them."""


def names(base: int, head: int, cross: int = 0) -> dict[str, str]:
    """Map all published keys with tensors to ours; the blocks of base and head are one list here."""
    layers = dict(LAYERS)
    if not cross:
        del layers["trans_base.word_emb"]
    blocks = [(f"trans_base.cross_att.{i}", f"cross_blocks.{i}", CROSS_BLOCK) for i in range(cross)]
    blocks += [(f"trans_base.blocks.{i}", f"blocks.{i}", BLOCK) for i in range(base)]
    blocks += [(f"trans_head.blocks.{i}", f"blocks.{base + i}", BLOCK) for i in range(head)]
    for theirs, ours, block in blocks:
        layers |= {f"{theirs}.{part}": f"{ours}.{own}" for part, own in block.items()}
    return MATRICES | {f"{theirs}.{t}": f"{ours}.{t}" for theirs, ours in layers.items() for t in ("weight", "bias")}


def latents(state: Mapping[str, Tensor]) -> int:
    """Return the most latents of a motion by the table of positions, which no forward reads; 49 without one."""
    table = state.get(POSITIONS)
    return LATENTS if table is None else len(table) - FURTHER


def load(
    state: Mapping[str, Tensor],
    *,
    heads: int = 16,
    dropout: float = 0.1,
    pkeep: float = 0.5,
    words: str = "real",
    max_latents: int | None = None,
    downsample: int = 4,
    sampling: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Load a published transformer; sizes follow from the shapes.

    Published AttT2M saw all 77 positions of CLIP's words: words="all" does so too, given features of 77 positions.
    """
    cross = count(state, r"trans_base\.cross_att\.(\d+)\.")
    kind = "attt2m" if cross else "t2m-gpt"
    base, head = (count(state, rf"trans_{part}\.blocks\.(\d+)\.") for part in ("base", "head"))
    classes, width = require(state, "trans_head.head.weight", kind=kind).shape
    spec = {
        "_target_": "kinema.generators.gpt.T2MGPT",
        "codebook_size": classes - 1,
        "text_dim": require(state, "trans_base.cond_emb.weight", kind=kind).shape[1],
        "token_dim": require(state, "trans_base.word_emb.weight", kind=kind).shape[1] if cross else None,
        "width": width,
        "feedforward": require(state, "trans_head.blocks.0.mlp.0.weight", kind=kind).shape[0],
        "layers": base + head,
        "cross_layers": cross,
        "heads": heads,
        "dropout": dropout,
        "pkeep": pkeep,
        "words": words,
        "max_latents": latents(state) if max_latents is None else max_latents,
        "downsample": downsample,
        "sampling": {"_target_": "kinema.generators.gpt.GptSampling", **(sampling or {})},
    }
    rules: list[tuple[str, str | None]] = [
        (re.escape(theirs), ours) for theirs, ours in names(base, head, cross).items()
    ]
    # Constants, and a table of positions that no published forward reads.
    rules += [(r".+\.attn\.mask|trans_base\.pos_embed\.embed|trans_base\.pos_embedding\.weight", None)]
    return transfer(spec, state, rules, kind=kind)


def export(model: T2MGPT, *, words: int = 77) -> dict[str, Tensor]:
    """Return a model's weights under the published keys, its constants included; half of the blocks are the base's."""
    own, device = model.state_dict(), model.head.weight.device
    positions = model.space.most + FURTHER
    base, cross = len(model.blocks) // 2, len(model.cross_blocks)
    head = len(model.blocks) - base
    state = {theirs: own[ours] for theirs, ours in names(base, head, cross).items()}
    width = model.head.in_features
    state[POSITIONS] = torch.zeros(positions, width, device=device)
    state["trans_base.pos_embed.embed"] = sinusoidal_positions(positions, width, device)[:, None]
    blocks = [f"trans_base.blocks.{i}" for i in range(base)] + [f"trans_head.blocks.{i}" for i in range(head)]
    masks = [(block, positions) for block in blocks]
    masks += [(f"trans_base.cross_att.{i}", words) for i in range(cross)]
    for block, columns in masks:
        state[f"{block}.attn.mask"] = torch.ones(positions, columns, device=device).tril()[None, None]
    return state
