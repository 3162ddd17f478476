"""Compute products in bfloat16, with weights that are cast once."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Literal, get_args

import torch
from torch import nn

Precision = Literal["float32", "bfloat16"]
PRECISIONS = get_args(Precision)
PRODUCTS = (nn.Linear, nn.Conv1d, nn.Conv2d)
"""Layers that are a product: what is most of the time, and loses least by a shorter fraction."""


def cast_products(module: nn.Module) -> None:
    """Keep the weights of products in bfloat16, for good; `computing` casts what meets them.

    Left to autocast alone every call casts every weight again: at small sizes that is more than the products save.
    """
    for part in module.modules():
        if isinstance(part, PRODUCTS):
            part.to(torch.bfloat16)


def computing(precision: Precision, device: torch.device) -> AbstractContextManager[object]:
    """Compute products, attention among them, in this precision; fp32 leaves things as the caller has them."""
    return nullcontext() if precision == "float32" else torch.autocast(device.type, torch.bfloat16)
