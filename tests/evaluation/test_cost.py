"""Operations are counted as the formulas say, for as many steps as the sampler takes."""

from __future__ import annotations

import pytest
import torch

from kinema.data.store import PackedStore
from kinema.evaluation.cost import counting, operations, parameters
from kinema.experiments.config import compose, plain
from kinema.experiments.corpus import open_corpus
from kinema.experiments.pages.subjects import read_motions
from kinema.experiments.pages.untrained import untrained
from kinema.nn.diffusion_mlp import DiffusionMLP
from kinema.runs.build import build


def test_a_row_through_the_published_mlp_costs_what_the_specification_says():
    """MARDM §5: 541.3 MFLOP."""
    with torch.device("meta"):
        mlp = DiffusionMLP(latent_dim=512, condition_dim=1024, width=1792, depth=16)
        with counting() as counter:
            mlp(torch.zeros(1, 512), torch.zeros(1), torch.zeros(1, 1024))
    assert counter.get_total_flops() == pytest.approx(541.3e6, rel=1e-3)
    assert parameters(torch.nn.ModuleList([mlp, mlp])) == parameters(mlp) > 250e6


def test_attention_and_its_gradients_are_counted_where_the_cpu_has_kernels_of_its_own():
    """Two products of 2 x 4 x 50 x 50 x 16; backwards those again for the scores, and four for gradients."""
    query, key, value = torch.randn(3, 2, 4, 50, 16, requires_grad=True)
    product = 2 * 2 * 4 * 50 * 50 * 16
    with counting() as counter:
        attended = torch.nn.functional.scaled_dot_product_attention(query, key, value)
        assert counter.get_total_flops() == 2 * product
        attended.sum().backward()
    assert counter.get_total_flops() == (2 + 5) * product


def test_operations_follow_the_sampler(micro):
    cfg = compose([*micro, "method=mardm_ddpm"], "evaluate")
    store = PackedStore.open(open_corpus(cfg))
    model = untrained(cfg, store, read_motions(store, "test", 2))

    def count(frames: int, steps: int) -> int:
        sampling = {**plain(cfg.generator.sampling), "solver": "ddim", "solver_steps": steps}
        return operations(model, "a person walks", frames, sampling=build(sampling))

    two, four, eight = (count(64, steps) for steps in (2, 4, 8))
    assert eight - four == 2 * (four - two) > 0
    assert count(128, 2) > 1.5 * two
