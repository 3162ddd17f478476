"""A codebook learns from real rows only, the same after a resume and on two processes, and resets what is dead."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
import torch.distributed as dist
import torch.multiprocessing as mp

from kinema.tokenizers.codebook import RESETS, EMACodebook, accumulate, assign, perplexity, tile
from kinema.tokenizers.rvq import ResidualQuantizer

SIZE, DIM = 12, 4


def rows(seed: int, batch=4, positions=6) -> torch.Tensor:
    return torch.randn(batch, positions, DIM, generator=torch.Generator().manual_seed(seed))


def real(*lengths: int, size=6) -> torch.Tensor:
    return torch.arange(size) < torch.tensor(lengths)[:, None]


def make(kind: str, **options) -> torch.nn.Module:
    if kind == "residual":
        return ResidualQuantizer(SIZE, DIM, quantizers=3, **options).train()
    return EMACodebook(SIZE, DIM, reset=kind, **options).train()


def teach(quantizer: torch.nn.Module, steps: range, batch=4, shard=(0, 1)) -> list:
    """Take training steps whose data and draws are functions of the step, ragged lengths included."""
    results, (rank, world) = [], shard
    mine = slice(rank * batch // world, (rank + 1) * batch // world)
    for step in steps:
        lengths = [1 + (step + i) % 6 for i in range(batch)]
        z, mask = rows(step, batch)[mine], real(*lengths)[mine]
        positions = int(mask.sum(1).max())
        generator = torch.Generator().manual_seed(step)
        results.append(quantizer(z[:, :positions], mask[:, :positions], generator, shard))
    return results


@pytest.mark.parametrize("kind", [*RESETS, "residual"])
def test_a_resumed_run_goes_on_exactly(kind):
    whole, first, second = make(kind), make(kind), make(kind)
    teach(whole, range(60))
    teach(first, range(33))
    second.load_state_dict(first.state_dict())
    teach(second, range(33, 60))
    assert whole.state_dict().keys() == second.state_dict().keys()
    for name, value in whole.state_dict().items():
        assert torch.equal(value, second.state_dict()[name]), name


@pytest.mark.parametrize("kind", [*RESETS, "residual"])
def test_padding_teaches_nothing(kind):
    states = []
    for fill in (0.0, 1e6, float("nan")):
        quantizer, mask = make(kind, temperature=0.5), real(6, 3, 1, 0)
        for step in range(3):
            z = rows(step).masked_fill(~mask[..., None], fill)
            result = quantizer(z, mask, torch.Generator().manual_seed(step))
        states.append([*quantizer.state_dict().values(), result.commit, result.perplexity, result.values, result.codes])
        assert not result.values[~mask].any()
        assert not result.codes[~mask].any()
    for other in states[1:]:
        assert all(torch.equal(a, b) for a, b in zip(states[0], other, strict=True))


def test_evaluation_teaches_nothing():
    quantizer = make("always")
    teach(quantizer, range(3))
    before = {k: v.clone() for k, v in quantizer.state_dict().items()}
    quantizer.eval()(rows(9), real(6, 6, 2, 1))
    assert all(torch.equal(v, before[k]) for k, v in quantizer.state_dict().items())


def test_codes_are_the_nearest():
    z, codebook = rows(0), rows(1).flatten(0, 1)[:SIZE]
    assert torch.equal(assign(z, codebook), torch.cdist(z, codebook.expand(4, -1, -1)).argmin(-1))


def test_codes_are_drawn_by_their_distance():
    z, codebook = torch.zeros(20_000, 1), torch.tensor([[0.0], [0.5], [1.0]])
    uniform = torch.rand(20_000, 3, generator=torch.Generator().manual_seed(0))
    share = torch.bincount(assign(z, codebook, uniform, 0.5), minlength=3) / 20_000
    expected = torch.softmax(-codebook[:, 0].square() / 0.5, dim=0)
    torch.testing.assert_close(share, expected, rtol=0, atol=0.015)


def test_sums_and_counts_follow_the_rows():
    z, codes = torch.tensor([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), torch.tensor([1, 1, 0])
    sums, counts = accumulate(torch.ones(3, 2), torch.ones(3), z, codes, 0.5)
    torch.testing.assert_close(sums, torch.tensor([[3.0, 3.5], [2.5, 3.5], [0.5, 0.5]]))
    torch.testing.assert_close(counts, torch.tensor([1.0, 1.5, 0.5]))


def far_from_the_rows(reset: str) -> EMACodebook:
    """Give a codebook of which the first code is the nearest to every row and the others are dead."""
    quantizer = make(reset)
    quantizer.start_from(torch.full((SIZE, DIM), 50.0) + 10 * torch.arange(SIZE)[:, None])
    quantizer.counts.fill_(0.5)
    return quantizer


def test_dead_codes_become_rows_of_the_batch_at_once():
    quantizer, full = far_from_the_rows("always"), real(6, 6, 6, 6)
    quantizer(rows(0), full)
    assert torch.equal(quantizer.codebook[1:], rows(0).flatten(0, 1)[1:SIZE])
    assert quantizer.counts[0] < 1 <= quantizer.counts[0] + 0.5
    assert (quantizer(rows(1), full).codes > 0).any()


def test_unused_codes_become_rows_of_the_batch_every_21st_step_for_one_step():
    quantizer, full, moved = far_from_the_rows("unused"), real(6, 6, 6, 6), []
    for step in range(64):
        quantizer(rows(step), full, torch.Generator().manual_seed(step))
        distances = torch.cdist(quantizer.codebook[-1:], rows(step).flatten(0, 1))
        moved += [step] if distances.min() == 0 else []
    assert moved == [20, 41, 62]


def test_a_code_that_nothing_ever_chose_stays_finite():
    quantizer = make("unused")
    teach(quantizer, range(2))
    quantizer.counts[3] = quantizer.sums[3] = 0.0
    quantizer.used[3] = True
    quantizer.codebook[3] = 1e3
    teach(quantizer, range(2, 5))
    assert torch.isfinite(quantizer.codebook).all()
    assert (quantizer.codebook[3] == 1e3).all()


def test_the_share_of_dead_codes_is_of_the_threshold():
    quantizer = make("always", threshold=0.5)
    quantizer.start_from(torch.eye(SIZE)[:, :DIM])
    quantizer.counts[:3] = torch.tensor([0.1, 0.49, 0.6])
    assert quantizer.eval()(rows(0), real(6, 6, 6, 6)).dead_codes.item() == pytest.approx(2 / SIZE)


def test_perplexity_counts_the_codes_in_even_use():
    assert perplexity(torch.tensor([0, 1, 2, 3] * 5), 9).item() == pytest.approx(4, rel=1e-4)
    assert perplexity(torch.tensor([7] * 5), 9).item() == pytest.approx(1, rel=1e-4)


def test_the_gradient_passes_straight_through_and_commits():
    quantizer, z = make("always"), rows(3).requires_grad_()
    result = quantizer(z, real(6, 6, 6, 2))
    (result.values * 3).sum().backward()
    assert torch.equal(z.grad, 3.0 * real(6, 6, 6, 2)[..., None].expand_as(z))
    z.grad = None
    result = quantizer.eval()(z, real(6, 6, 6, 2))
    result.commit.backward()
    expected = 2 * (z - result.values).detach() / (20 * DIM)
    torch.testing.assert_close(z.grad, expected * real(6, 6, 6, 2)[..., None])
    assert z.grad.any()


def test_half_precision_quantises_in_full():
    quantizer = make("always")
    with torch.autocast("cpu", dtype=torch.bfloat16):
        result = quantizer(rows(0).bfloat16(), real(6, 6, 6, 6))
    assert result.values.dtype == quantizer.codebook.dtype == torch.float32


def test_lookup():
    quantizer = make("always")
    teach(quantizer, range(2))
    vectors = quantizer.lookup(torch.tensor([[[0], [-1], [SIZE - 1]]]))[0]
    assert torch.equal(vectors, torch.stack([quantizer.codebook[0], torch.zeros(DIM), quantizer.codebook[-1]]))
    for wrong in (SIZE, -2):
        with pytest.raises(ValueError, match=rf"id {wrong} is out of range.*0 to {SIZE - 1}"):
            quantizer.lookup(torch.tensor([[[0], [wrong]]]))


def test_what_cannot_work_is_named():
    with pytest.raises(ValueError, match=r"EMACodebook.reset=never: must be one of always, unused"):
        EMACodebook(4, 2, reset="never")
    with pytest.raises(ValueError, match="no real position"):
        make("always")(rows(0), real(0, 0, 0, 0))


def test_enough_rows_need_no_noise():
    z = rows(0).flatten(0, 1)
    assert tile(z, SIZE) is z


def work(rank: int, folder: Path) -> None:
    torch.set_num_threads(1)
    dist.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
    found = {}
    for kind in (*RESETS, "residual"):
        quantizer = make(kind)
        results = teach(quantizer, range(24), shard=(rank, 2))
        found[kind] = quantizer.state_dict(), [(r.codes, r.perplexity) for r in results]
    torch.save(found, folder / f"{rank}.pt")
    dist.barrier()
    dist.destroy_process_group()


@pytest.mark.slow
def test_two_processes_learn_what_one_does(tmp_path, monkeypatch):
    # The spawned processes import this file by the name that pytest gave it.
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parent))
    mp.spawn(work, args=(tmp_path,), nprocs=2)
    for kind in (*RESETS, "residual"):
        alone = make(kind)
        results = teach(alone, range(24))
        for rank in range(2):
            state, parts = torch.load(tmp_path / f"{rank}.pt", weights_only=True)[kind]
            assert all(torch.equal(v, state[k]) for k, v in alone.state_dict().items()), kind
            for result, (codes, spread) in zip(results, parts, strict=True):
                mine = result.codes[2 * rank : 2 * rank + 2, : codes.shape[1]]
                assert torch.equal(mine, codes)
                assert kind == "residual" or torch.equal(result.perplexity, spread)
