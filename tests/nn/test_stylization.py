"""Linear attention hides what it is told to, in every precision."""

from __future__ import annotations

import pytest
import torch

from kinema.nn.stylization import linear_attention


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.float16])
def test_what_is_masked_has_no_weight(dtype):
    generator = torch.Generator().manual_seed(0)
    query, key, value = (torch.randn(2, 3, 7, 8, generator=generator).to(dtype) for _ in range(3))
    mask = torch.arange(7).expand(2, 1, 7) < torch.tensor([[[7]], [[4]]])
    seen = linear_attention(query, key, value, mask)
    hidden = ~mask[..., None]
    other = linear_attention(query, key.masked_fill(hidden, 3.0), value.masked_fill(hidden, -3.0), mask)
    assert torch.equal(seen, other)
    assert seen.isfinite().all()
    alone = linear_attention(query[1:], key[1:, :, :4], value[1:, :, :4])
    torch.testing.assert_close(seen[1:], alone, atol={torch.float32: 1e-6}.get(dtype, 0.02), rtol=0.02)
