"""Load and write BAD's published transformer (`trans_best_fid.pth`, entry `trans`; BAD §2).

The tokenizer lies in the same file: `tokenizer(state)` is what kind `mmm-vq` loads.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.generators.bad.model import BAD
from kinema.interop import token_transformer
from kinema.interop.checkpoint import require, transfer

TABLE = "trans_base.learn_tok_emb.weight"
MMM_ROWS, MASKS = 3, 50

# Published name -> ours, of layers that hold a weight and a bias.
TIME = {
    f"trans_base.{theirs}.mlp.{i}": f"{ours}.{i}"
    for theirs, ours in (("t_embedder", "count_embedding"), ("l_embedder", "length_embedding"))
    for i in (0, 2)
}


def time_names() -> dict[str, str]:
    """Map the published keys of the time token to ours."""
    return {f"{theirs}.{t}": f"{ours}.{t}" for theirs, ours in TIME.items() for t in ("weight", "bias")}


def load(
    state: Mapping[str, Tensor],
    *,
    heads: int = 16,
    dropout: float = 0.1,
    words: str = "real",
    direction: str = "ge",
    unmasked_see_masks: bool = False,
    downsample: int = 4,
    from_mmm: bool = False,
    sampling: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Load a published transformer; sizes follow from the shapes, the time token from its keys.

    words="all" lets the padding of CLIP's 77 positions be seen, as published, given features of 77. `from_mmm` takes
    MMM's weights to train on from: its one mask token becomes all of BAD's.
    """
    kind = "bad"
    state = dict(state)
    rows = len(require(state, TABLE, kind=kind))
    if (rows == MMM_ROWS) != from_mmm:
        fix = "has BAD's masks; leave from_mmm out" if from_mmm else "is MMM's; load it as 'mmm', or with from_mmm=True"
        raise ValueError(f"this file with {rows - 2} mask tokens {fix}")
    if from_mmm:
        state[TABLE] = state[TABLE][[0, 1, *[2] * MASKS]]
    spec = {
        "_target_": "kinema.generators.bad.BAD",
        **token_transformer.sizes(state, kind),
        "heads": heads,
        "dropout": dropout,
        "words": words,
        "time_token": "trans_base.t_embedder.mlp.0.weight" in state,
        "direction": direction,
        "unmasked_see_masks": unmasked_see_masks,
        "max_latents": len(state[TABLE]) - MMM_ROWS,
        "downsample": downsample,
        "sampling": {"_target_": "kinema.generators.bad.BadSampling", **(sampling or {})},
    }
    rules = [(re.escape(theirs), ours) for theirs, ours in time_names().items()]
    return transfer(spec, state, [*rules, *token_transformer.rules(state)], kind=kind)


def tokenizer(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Take the state dict of the tokenizer out of that of the transformer (MMM's or BAD's)."""
    prefix = token_transformer.TOKENIZER
    return {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}


def export(model: BAD) -> dict[str, Tensor]:
    """Return a model's weights under the published keys; of the tokenizer inside, the codebook alone."""
    own = model.state_dict()
    state = token_transformer.export(model.transformer, model.max_latents + 1 + model.conditions)
    if model.count_embedding is not None:
        state |= {theirs: own[ours] for theirs, ours in time_names().items()}
    return state
