"""Load the published checkpoints as modules of this package: `load("mardm-ae", "latest.tar", statistics=...)`.

Each kind has one importer, a function `load(state, **options) -> nn.Module` in its own file. It is given the bare
published state dict (no wrapper, no `module.`, no `clip_model.*`; where a file holds several networks, as the
T2M-style evaluator's, their names are the keys' prefixes), derives every size from the shapes and takes as options
only what shapes cannot tell. It writes a build spec and renaming rules and leaves the rest to `checkpoint.transfer`,
which keeps the spec on the module (`.spec`): `kinema import` saves it as an artifact. autoencoder.py is the example.

Options that several importers share: `statistics`, the corpus' mean and std (a `Statistics`, a folder with `Mean.npy`
and `Std.npy`, or a pair of such paths). The published files carry none; without it the module's representation stays
unfitted and says so on first use.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import nn

from kinema.generators.tokens.generator import RESIDUAL
from kinema.interop.checkpoint import read_checkpoint, unwrap
from kinema.options import check
from kinema.runs.parts import CONTRASTIVE, DECOMPOSITION, GENERATOR, LENGTH, MATCHING, TOKENIZER

_BASE = ("t2m_transformer", "trans")
_MOVEMENT = ("movement_enc", "movement_dec")
_T2M = ("movement_encoder", "text_encoder", "motion_encoder")


@dataclass(frozen=True)
class Kind:
    """Describe a kind: its importer's module, the wrappers of its files (`several`: each holds a part) and its place.

    `part` is what it is of a method. A generator's `tokenizer` and `residual` name the kinds that it was published
    with; `retrieval` says that it reads a database, which no published file is.
    """

    module: str
    wrappers: tuple[str, ...]
    part: str
    tokenizer: str | None = None
    residual: str | None = None
    retrieval: bool = False
    several: bool = False


KINDS: dict[str, Kind] = {
    "mardm-ae": Kind("kinema.interop.autoencoder", ("ae",), TOKENIZER),
    "t2m-gpt-vq": Kind("kinema.interop.vq", ("net",), TOKENIZER),
    "attt2m-vq": Kind("kinema.interop.attt2m_vq", ("net",), TOKENIZER),
    "mmm-vq": Kind("kinema.interop.vq", ("net",), TOKENIZER),
    "momask-rvq": Kind("kinema.interop.rvq", ("vq_model", "net"), TOKENIZER),
    "frames": Kind("kinema.interop.frames", ("model_avg", "model", "encoder", "state_dict"), TOKENIZER),
    "mld-vae": Kind("kinema.interop.mld_vae", ("vae",), TOKENIZER),
    "mardm": Kind("kinema.interop.mardm", ("ema_mardm", "mardm"), GENERATOR, "mardm-ae"),
    "t2m-gpt": Kind("kinema.interop.gpt", ("trans",), GENERATOR, "t2m-gpt-vq"),
    "attt2m": Kind("kinema.interop.gpt", ("trans",), GENERATOR, "attt2m-vq"),
    "mmm": Kind("kinema.interop.mmm", ("trans",), GENERATOR, "mmm-vq"),
    "bad": Kind("kinema.interop.bad", ("trans",), GENERATOR, "mmm-vq"),
    "momask": Kind("kinema.interop.momask", _BASE, GENERATOR, "momask-rvq", "momask-residual"),
    "bamm": Kind("kinema.interop.bamm", _BASE, GENERATOR, "momask-rvq", "momask-residual"),
    "mdm": Kind("kinema.interop.mdm", ("model_avg", "model"), GENERATOR, "frames"),
    "motiondiffuse": Kind("kinema.interop.motiondiffuse", ("encoder",), GENERATOR, "frames"),
    "remodiffuse": Kind("kinema.interop.remodiffuse", ("state_dict",), GENERATOR, "frames", retrieval=True),
    "mld": Kind("kinema.interop.mld", ("denoiser",), GENERATOR, "mld-vae"),
    "momask-residual": Kind("kinema.interop.momask_residual", ("res_transformer",), RESIDUAL, "momask-rvq"),
    "length-estimator": Kind("kinema.interop.length_estimator", ("estimator",), LENGTH),
    "t2m-evaluator": Kind("kinema.interop.t2m_evaluator", _T2M, MATCHING, several=True),
    "t2m-decomposition": Kind("kinema.interop.t2m_decomposition", _MOVEMENT, DECOMPOSITION, several=True),
    "clip-evaluator": Kind("kinema.interop.clip_evaluator", ("contrast_model",), CONTRASTIVE),
}


def load(kind: str, source: str | Path | Mapping[str, Any], /, **options: Any) -> nn.Module:
    """Load a published checkpoint (a file or its content) as a module in eval mode.

    Raises ValueError for an unknown kind or option, a damaged file or one that holds code, or keys that don't fit.
    """
    known = find_kind(kind)
    importer = importlib.import_module(known.module).load
    options = _checked(kind, importer, options)
    content = source if isinstance(source, Mapping) else read_checkpoint(source)
    return importer(unwrap(content, known.wrappers, several=known.several), **options).eval()


def find_kind(kind: str) -> Kind:
    """Return a kind by its name; raises ValueError for an unknown one."""
    if kind not in KINDS:
        raise ValueError(f"unknown kind of checkpoint {kind!r}; allowed: {', '.join(KINDS)}")
    return KINDS[kind]


def _checked(kind: str, importer: Any, options: dict[str, Any]) -> dict[str, Any]:
    parameters = list(inspect.signature(importer).parameters.values())[1:]
    allowed = [p.name for p in parameters]
    for name in options:
        if name not in allowed:
            raise ValueError(f"{kind!r} has no option {name!r}; allowed: {', '.join(allowed) or 'none'}")
    for parameter in parameters:
        if parameter.default is parameter.empty and parameter.name not in options:
            raise ValueError(f"{kind!r} needs the option {parameter.name!r}: {inspect.getdoc(importer)}")
    check(importer, options, kind)
    return options
