"""Load and write the T2M-style evaluator's file: `text_mot_match/model/finest.tar`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.interop.checkpoint import require, transfer
from kinema.interop.representation import fit_statistics, representation_spec

_CONTACTS = 4
_INPUTS_WITHOUT_CONTACTS = (259, 247)
OURS = ("representation.", "vocabulary_fingerprint")


def load(
    state: Mapping[str, Tensor],
    *,
    statistics: Any = None,
    variant: str | None = None,
    padding: str = "masked",
    negative_shift: str = "nonzero",
    margin: float = 10.0,
    max_frames: int = 196,
) -> nn.Module:
    """Load a published matching pair (T2M_EVALUATOR §2); attach word vectors before embedding text.

    `variant` says how `statistics` become the evaluator's: "raw" (the 67/64-dim one's default) or "published" (root and
    contact deviations are divided by 25 here; the 263/251-dim one's default). Pass "raw" for arrays shipped with the
    original evaluator, which are divided already.
    """
    kind = "t2m-evaluator"
    width, inputs, _ = require(state, "movement_encoder.main.0.weight", kind=kind).shape
    drop_contacts = inputs in _INPUTS_WITHOUT_CONTACTS
    hidden, movement = require(state, "motion_encoder.input_emb.weight", kind=kind).shape
    spec = {
        "_target_": "kinema.evaluation.encoders.t2m.MatchingEvaluator",
        "representation": representation_spec(inputs + _CONTACTS * drop_contacts, variant=variant),
        "word_width": require(state, "text_encoder.pos_emb.weight", kind=kind).shape[0],
        "movement_width": width,
        "movement_dim": movement,
        "motion_hidden": hidden,
        "text_hidden": require(state, "text_encoder.input_emb.weight", kind=kind).shape[0],
        "embedding": require(state, "motion_encoder.output_net.3.weight", kind=kind).shape[0],
        "margin": margin,
        "negative_shift": negative_shift,
        "padding": padding,
        "drop_contacts": drop_contacts,
        "max_frames": max_frames,
    }
    rules = [(r"((?:movement|motion|text)_encoder\..+)", r"\1")]
    return fit_statistics(transfer(spec, state, rules, kind=kind, ours=OURS), statistics)


def export(module: nn.Module) -> dict[str, dict[str, Tensor]]:
    """Return the entries of a published `finest.tar` from a MatchingEvaluator."""
    return {name: _part(module, name) for name in ("movement_encoder", "text_encoder", "motion_encoder")}


def _part(module: nn.Module, name: str) -> dict[str, Tensor]:
    return {re.sub(f"^{name}\\.", "", k): v for k, v in module.state_dict().items() if k.startswith(f"{name}.")}
