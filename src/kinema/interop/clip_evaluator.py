"""Load and write MARDM's CLIP-style evaluator: `text_mot_match_clip/model/finest.tar` (CLIP_EVALUATOR §1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.evaluation.encoders.clip_style import ContrastiveEvaluator
from kinema.interop.checkpoint import Rules, count, require, transfer
from kinema.interop.representation import fit_statistics, representation_spec

_RULES: Rules = [
    (r"motion_encoder\.sequence_pos_encoder\.pe", None),  # a constant, computed anew
    (r"(motion_encoder\.(?:query_token|embed_motion\..+|transformer\..+|out_ln\..+|out\..+))", r"\1"),
    (r"textTransEncoder\.(.+)", r"text_encoder.transformer.\1"),
    (r"(text_ln\..+|out\..+)", r"text_encoder.\1"),
    (r"logit_scale", r"logit_scale"),
    (r"token_embedding\.weight", r"token_embedding"),
    (r"positional_embedding", r"token_positions"),
]


def load(state: Mapping[str, Tensor], *, statistics: Any = None, heads: int = 8, dropout: float = 0.2) -> nn.Module:
    """Load a published contrastive pair with its own token embedding; attach a CLIP token table for the ids.

    `heads` cannot be told from shapes.
    """
    kind = "clip-evaluator"
    width, inputs = require(state, "motion_encoder.embed_motion.weight", kind=kind).shape
    vocabulary, token_width = require(state, "token_embedding.weight", kind=kind).shape
    spec = {
        "_target_": "kinema.evaluation.encoders.clip_style.ContrastiveEvaluator",
        "representation": representation_spec(inputs),
        "token_width": token_width,
        "width": width,
        "layers": count(state, r"motion_encoder\.transformer\.layers\.(\d+)\."),
        "heads": heads,
        "feedforward": require(state, "motion_encoder.transformer.layers.0.linear1.weight", kind=kind).shape[0],
        "dropout": dropout,
        "embedding": require(state, "out.weight", kind=kind).shape[0],
        "vocabulary": vocabulary,
        "context": require(state, "positional_embedding", kind=kind).shape[0],
    }
    module = transfer(spec, state, _RULES, kind=kind, ours=("representation.", "vocabulary_fingerprint"))
    return fit_statistics(module, statistics)


def export(module: ContrastiveEvaluator) -> dict[str, dict[str, Tensor]]:
    """Return the entry of a published file from a ContrastiveEvaluator.

    Raises ValueError if it owns no token embedding or projects it.
    """
    if module.token_embedding is None or module.token_width != module.motion_encoder.query_token.shape[1]:
        raise ValueError(
            "the published format holds its own token embedding of the transformer's width; build the evaluator with "
            "vocabulary=... and token_width equal to width"
        )
    state = {"motion_encoder.sequence_pos_encoder.pe": module.motion_encoder.positions}
    renames = {
        "text_encoder.transformer.": "textTransEncoder.",
        "text_encoder.": "",
        "token_embedding": "token_embedding.weight",
        "token_positions": "positional_embedding",
    }
    for key, value in module.state_dict().items():
        if key.startswith(("representation.", "vocabulary_fingerprint")):
            continue
        ours = next((prefix for prefix in renames if key.startswith(prefix)), None)
        state[key if ours is None else renames[ours] + key[len(ours) :]] = value
    return {"contrast_model": state}
