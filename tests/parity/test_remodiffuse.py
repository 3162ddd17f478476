"""Compare ReMoDiffuse with the published modules: retrieval, mixture, network, loss and DDIM, its draws injected."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from kinema import interop
from kinema.diffusion.errors import per_frame
from kinema.diffusion.schedules import make_schedule
from kinema.generators.remodiffuse import MixtureSampling, ReMoDiffuse, RetrievalDatabase
from kinema.generators.remodiffuse.database import Neighbours, best
from kinema.types import TextFeatures, frame_mask


def read(golden_file, name: str) -> dict[str, Tensor]:
    return load_file(golden_file(f"diffusion/remodiffuse_{name}.safetensors"))


def close(ours: Tensor, theirs: Tensor, rtol: float = 1e-4, atol: float = 1e-5) -> None:
    torch.testing.assert_close(ours, theirs, rtol=rtol, atol=atol)


def load_model(golden: dict[str, Tensor]) -> ReMoDiffuse:
    state = {k.removeprefix("sd."): v for k, v in golden.items() if k.startswith("sd.")}
    return interop.load("remodiffuse", {"state_dict": {f"model.{k}": v for k, v in state.items()}}, heads=4)


def conditions(model: ReMoDiffuse, golden: dict[str, Tensor]) -> dict:
    """Read the text and the neighbours that the file gives."""
    tokens = golden["in.retrieved_text_features"]
    neighbours = Neighbours(
        golden["in.retrieved_motion"], golden["in.retrieved_length"], tokens, torch.full(tokens.shape[:2], 77)
    )
    text = TextFeatures(["", ""], torch.zeros(2, 1), golden["in.clip_token_features"])
    words, seen = model._read(text)
    return {
        "words": words,
        "seen": seen,
        "real": frame_mask(golden["in.lengths"], 18),
        "retrieved": model.denoiser.retrieval(neighbours),
    }


def test_retrieval(golden_file):
    golden = read(golden_file, "retrieval")
    size = len(golden["in.db_lengths"])
    database = RetrievalDatabase.holding(
        pooled=golden["in.db_text_features"],
        tokens=[torch.zeros(1, 1)] * size,
        frames=torch.zeros(1, 1),
        starts=torch.zeros(size, dtype=torch.long),
        lengths=golden["in.db_lengths"],
        families=torch.arange(size),
        captions=torch.arange(size)[:, None].expand(size, 2).clone(),
        names=[str(i) for i in range(size)],
    )
    lengths = golden["in.query_length"]
    scores = database.scores(golden["in.query"], lengths)
    close(scores, golden["out.score"])
    close(database.scores(golden["in.query"], lengths, length_weight=0.0), golden["out.cosine"])
    assert torch.equal(best(scores, size), golden["out.rank_eval"])
    assert torch.equal(best(scores, 2), golden["out.topk_eval"])
    assert torch.equal(best(scores, 2, database.same_length(lengths)), golden["out.topk_train"])


def test_mixture(golden_file):
    golden = read(golden_file, "mixture")
    branches = torch.stack((golden["out.weights_choice0"], golden["out.weights_choice1"]), dim=1)
    for time, expected in zip(golden["in.t"], branches, strict=True):
        weights = MixtureSampling().mixture(time.item() / 1000, torch.tensor([False, True]))
        close(weights, expected, rtol=1e-9, atol=1e-12)


def test_schedule(golden_file):
    golden = read(golden_file, "mixture")
    schedule = make_schedule("linear", 1000).respace("15,15,8,6,6")
    assert torch.equal(schedule.timesteps, golden["out.timestep_map"])
    tables = [name for name in golden if name.startswith("respaced.") and "sqrt" not in name]
    assert len(tables) == 7
    for name in tables:
        close(getattr(schedule, name.removeprefix("respaced.")), golden[name], rtol=1e-9, atol=0)


def test_what_is_read(golden_file):
    golden = read(golden_file, "denoiser")
    read_ = conditions(load_model(golden), golden)
    close(read_["words"], golden["out.xf_out"], atol=6e-5)
    retrieved = read_["retrieved"]
    seen = retrieved.seen  # padding isn't computed
    close(retrieved.motions[seen], golden["out.re_motion"].flatten(1, 2)[seen], atol=3e-5)
    close(retrieved.texts, golden["out.re_text"].expand(2, 2, 5, 32).flatten(1, 2), atol=2e-5)
    assert torch.equal(retrieved.seen, golden["out.re_mask"].flatten(1).bool())


def predict(model: ReMoDiffuse, golden: dict[str, Tensor], x: Tensor, text: Tensor, retrieval: Tensor) -> Tensor:
    read_ = conditions(model, golden)
    retrieved = read_["retrieved"].rows(torch.arange(2), retrieval)
    seen = read_["seen"] & text[:, None]
    return model.denoiser(x, golden["in.t"], read_["words"], seen, read_["real"], retrieved)


def computed(golden: dict[str, Tensor], theirs: Tensor) -> Tensor:
    """Take padding, which ours doesn't compute, from the published frames."""
    return theirs * frame_mask(golden["in.lengths"], 18)[..., None]


@pytest.mark.parametrize(
    ("name", "text", "retrieval"),
    [("both", True, True), ("text", True, False), ("retr", False, True), ("none", False, False)],
)
def test_each_pass(golden_file, name, text, retrieval):
    golden = read(golden_file, "denoiser")
    flags = (torch.tensor([flag, flag]) for flag in (text, retrieval))
    predicted = predict(load_model(golden), golden, golden["in.x"], *flags)
    close(predicted, computed(golden, golden[f"out.pred_{name}"]))


def test_a_condition_per_sample_and_the_loss(golden_file):
    golden = read(golden_file, "denoiser")
    model, code = load_model(golden), golden["in.cond_type"].flatten()
    flags = code % 10 > 0, code // 10 > 0
    mixed = predict(model, golden, golden["in.x"], *flags)
    close(mixed, computed(golden, golden["out.pred_mixed_conditions"]))
    predicted = predict(
        model, golden, model.process.add_noise(golden["in.x0"], golden["in.t"], golden["in.noise"]), *flags
    )
    close(predicted, computed(golden, golden["out.loss_pred"]))
    rows = per_frame((predicted - golden["in.x0"]).square(), frame_mask(golden["in.lengths"], 18))
    close(rows.mean(), golden["out.loss"])


@pytest.mark.parametrize(("time", "branch"), [(57, 0), (800, 0), (800, 1)])
def test_four_passes(golden_file, time, branch):
    golden = read(golden_file, "denoiser")
    model = load_model(golden)
    weights = MixtureSampling().mixture(time / 1000, torch.full((2,), bool(branch)))
    mixed = model.mixed(golden["in.x"], torch.tensor([time]), weights=weights, **conditions(model, golden))
    close(mixed, computed(golden, golden[f"out.test_t{time}_choice{branch}"]), atol=6e-5)


def test_samples(golden_file):
    golden = read(golden_file, "ddim")
    model = load_model(golden)
    read_, branches, seen = conditions(model, golden), iter(golden["rng.branch"].tolist()), []

    def predicted(x: Tensor, time: Tensor) -> Tensor:
        seen.append(x)
        alone = torch.full((2,), bool(time.item() > 100 and next(branches)))
        weights = MixtureSampling().mixture(time.item() / 1000, alone)
        return model.mixed(x, time, weights=weights, **read_)

    options = model.sampling
    made = model.process.sample(predicted, iter([golden["rng.x_T"]]), solver=options.solver, steps=options.solver_steps)
    real = read_["real"]
    for step, x in zip((0, 9, 24, 40, 48), golden["out.ddim_traj"], strict=True):
        close(seen[step + 1][real], x[real], atol=8e-5)
    close(made[real], golden["out.ddim_sample"][real], atol=1e-4)
    assert next(branches, None) is None
