"""Name the published keys of the transformer that MMM and BAD share (entry `trans`; MMM, BAD §2)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from kinema.generators.tokens.transformer import TokenTransformer
from kinema.interop.checkpoint import Rules, count, require
from kinema.interop.gpt import BLOCK, CROSS_BLOCK, POSITIONS
from kinema.nn.embeddings import sinusoidal_positions

TOKENIZER = "trans_base.vqvae."
CODEBOOK = f"{TOKENIZER}vqvae.quantizer.codebook"
WORDS = 77

# Published name -> ours, of layers that hold a weight and a bias.
LAYERS = {
    "trans_base.to_emb": "input_projection",
    "trans_base.cond_emb": "text_projection",
    "trans_head.ln_f": "norm",
}
MATRICES = {"trans_base.learn_tok_emb.weight": "special.weight", "trans_head.head.weight": "head.weight"}


def names(cross: int, base: int, head: int) -> dict[str, str]:
    """Map the published keys to ours in a module that holds a `TokenTransformer` as `transformer`."""
    layers = LAYERS | ({"trans_base.word_emb": "word_projection"} if cross else {})
    blocks = [(f"trans_base.cross_att.{i}", f"cross_blocks.{i}", CROSS_BLOCK) for i in range(cross)]
    blocks += [(f"trans_base.blocks.{i}", f"base_blocks.{i}", BLOCK) for i in range(base)]
    blocks += [(f"trans_head.blocks.{i}", f"head_blocks.{i}", BLOCK) for i in range(head)]
    for theirs, ours, block in blocks:
        layers = layers | {f"{theirs}.{part}": f"{ours}.{own}" for part, own in block.items()}
    both = {f"{theirs}.{t}": f"{ours}.{t}" for theirs, ours in layers.items() for t in ("weight", "bias")}
    return {theirs: f"transformer.{ours}" for theirs, ours in (both | MATRICES | {CODEBOOK: "codebook"}).items()}


def rules(state: Mapping[str, Tensor]) -> Rules:
    """Return the renaming rules; of the tokenizer inside, the codebook alone is taken, constants are computed by us."""
    renamed = [(re.escape(theirs), ours) for theirs, ours in names(*_depths(state)).items()]
    return [*renamed, (rf"{re.escape(TOKENIZER)}.+|.+\.attn\.mask|trans_base\.pos_embed(ding)?\..+", None)]


def sizes(state: Mapping[str, Tensor], kind: str) -> dict[str, Any]:
    """Derive the sizes that the shapes tell, as the constructors of MMM and BAD name them."""
    codebook_size, code_dim = require(state, CODEBOOK, kind=kind).shape
    cross, base, head = _depths(state)
    text_dim = require(state, "trans_base.cond_emb.weight", kind=kind).shape[1]
    return {
        "codebook_size": codebook_size,
        "code_dim": code_dim,
        "text_dim": text_dim,
        "token_dim": require(state, "trans_base.word_emb.weight", kind=kind).shape[1] if cross else text_dim,
        "width": require(state, "trans_base.to_emb.weight", kind=kind).shape[0],
        "feedforward": require(state, "trans_head.blocks.0.mlp.0.weight", kind=kind).shape[0],
        "cross_layers": cross,
        "base_layers": base,
        "head_layers": head,
    }


def export(transformer: TokenTransformer, positions: int) -> dict[str, Tensor]:
    """Return the weights under the published keys with their constants; of the tokenizer inside, the codebook alone."""
    parts = (transformer.cross_blocks, transformer.base_blocks, transformer.head_blocks)
    own, device = transformer.state_dict(), transformer.codebook.device
    width = transformer.head.in_features
    state = {k: own[ours.removeprefix("transformer.")] for k, ours in names(*map(len, parts)).items()}
    state[POSITIONS] = torch.zeros(positions, width, device=device)
    state["trans_base.pos_embed.embed"] = sinusoidal_positions(positions, width, device)[:, None]
    for i in range(len(transformer.cross_blocks)):
        mask = torch.ones(positions, WORDS, device=device).tril()
        state[f"trans_base.cross_att.{i}.attn.mask"] = mask[None, None]
    return state


def _depths(state: Mapping[str, Tensor]) -> tuple[int, int, int]:
    patterns = (r"trans_base\.cross_att\.(\d+)\.", r"trans_base\.blocks\.(\d+)\.", r"trans_head\.blocks\.(\d+)\.")
    cross, base, head = (count(state, pattern) for pattern in patterns)
    return cross, base, head
