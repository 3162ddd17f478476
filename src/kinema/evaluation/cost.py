"""Count what a method costs: its parameters, and the operations of making one motion (MARDM, Figure 1)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode, sdpa_backward_flop_count, sdpa_flop_count

from kinema.pipeline import TextToMotion


def _attention(query: Any, key: Any, value: Any, *_: Any, **__: Any) -> int:
    return sdpa_flop_count(query, key, value)


def _attention_backward(gradient: Any, query: Any, key: Any, value: Any, *_: Any, **__: Any) -> int:
    return sdpa_backward_flop_count(gradient, query, key, value)


_ON_CPU = {  # PyTorch has formulas for what other devices attend with: the CPU's kernels cost the same
    torch.ops.aten._scaled_dot_product_flash_attention_for_cpu: _attention,
    torch.ops.aten._scaled_dot_product_flash_attention_for_cpu_backward: _attention_backward,
}


def parameters(module: nn.Module) -> int:
    """Count the parameters of a module, shared ones once."""
    return sum(p.numel() for p in module.parameters())


def counting() -> FlopCounterMode:
    """Return a context that counts the floating point operations of what runs inside, on any device.

    A multiplication and an addition are two; of matrix products, convolutions and attention alone, as is usual.
    `get_total_flops` of it is the count.
    """
    return FlopCounterMode(display=False, custom_mapping=_ON_CPU)


@torch.no_grad()
def operations(model: TextToMotion, text: str, frames: int, *, sampling: Any = None, seed: int = 0) -> int:
    """Count the floating point operations from a sentence's features to a motion of `frames` frames, decoding included.

    Encoding the text is left out: a frozen encoder does it, and caches keep it.
    """
    model.eval()
    features = model.text_encoder([text])
    with _frozen(model.tokenizer, model.generator, *model.parts.values()), counting() as counter:
        latents = model.sample_latents(features, torch.tensor([frames]), seeds=torch.tensor([seed]), sampling=sampling)
        model.tokenizer.decode(latents)
    return counter.get_total_flops()


@contextmanager
def _frozen(*modules: nn.Module) -> Iterator[None]:
    """Let no parameter ask for gradients: the counter's hooks look for them even where there are none."""
    learning = [p for module in modules for p in module.parameters() if p.requires_grad]
    for parameter in learning:
        parameter.requires_grad_(False)
    try:
        yield
    finally:
        for parameter in learning:
            parameter.requires_grad_(True)
