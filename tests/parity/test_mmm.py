"""Compare MMM with the published module: logits, loss, greedy and noisy generation, edits, batches of one."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from kinema import interop
from kinema.decoding.draws import Greedy
from kinema.decoding.token_unmasking import unmask_tokens
from kinema.generators.mmm import MMM, MmmDraws, MmmSampling
from kinema.interop import bad, mmm
from kinema.masking import shrinking_counts
from kinema.types import Known, Latents, TextFeatures, frame_mask

CLOSE = {"rtol": 1e-4, "atol": 1e-5}
END, PAD, MASK = 24, 25, 26


def read(golden_file, name: str) -> dict[str, Tensor]:
    return load_file(golden_file(f"vq/mmm_{name}.safetensors"))


def state(golden_file) -> dict[str, Tensor]:
    return {k.removeprefix("sd."): v for k, v in read(golden_file, "transformer").items() if k.startswith("sd.")}


def load(golden_file) -> MMM:
    return interop.load("mmm", {"trans": state(golden_file)}, heads=4, words="all")


def text(golden: dict[str, Tensor], rows: slice = slice(None)) -> TextFeatures:
    pooled, words = golden["in.text"][rows], golden["in.words"][rows]
    return TextFeatures([""] * len(pooled), pooled, words, torch.ones(words.shape[:2], dtype=torch.bool))


def ids_of(latents: Latents, slots: int = 50) -> Tensor:
    """Write codes as the published ids: END behind them, PAD to the end."""
    codes = latents.codes[..., 0]
    ids = torch.nn.functional.pad(codes, (0, slots - codes.shape[1]))
    ids = ids.masked_fill(~frame_mask(latents.lengths, slots), PAD)
    return ids.scatter(1, latents.lengths[:, None], END)


def whole_frames(golden: dict[str, Tensor]) -> Tensor:
    """Give the lengths as whole tokens: MMM rounds frames / 4 up, we down."""
    return (golden["in.m_length"] + 3) // 4 * 4


def test_logits(golden_file):
    golden, model = read(golden_file, "transformer"), load(golden_file)
    ids, lengths = golden["in.ids"], golden["in.lens"]
    logits = model(ids[:, :-1], text(golden), lengths)
    expected = golden["out.logits"] * frame_mask(lengths + 2, logits.shape[1])[..., None]  # padding isn't computed
    torch.testing.assert_close(logits, expected, **CLOSE)
    longest = int(lengths.max())
    assert longest + 2 < logits.shape[1]
    cropped = model(ids[:, :longest], text(golden), lengths)
    torch.testing.assert_close(cropped, expected[:, : longest + 2], **CLOSE)


def test_loss(golden_file):
    golden, model = read(golden_file, "transformer"), load(golden_file)
    lengths, masked = golden["in.lens"], golden["in.masked"]
    draws = MmmDraws(
        keep=golden["in.keep"],
        replacement=golden["in.random_ids"],
        ratio=masked.sum(dim=1) / lengths,
        order=1.0 - masked.float(),
    )
    latents = Latents(lengths=lengths, frames=lengths * 4, codes=golden["in.target"][..., None])
    loss = model.loss(latents, text(golden), draws=draws)["loss"]
    torch.testing.assert_close(loss, golden["out.loss"], **CLOSE)


def test_greedy_generation(golden_file):
    golden = read(golden_file, "generate")
    result = load(golden_file).sample(
        text(golden), whole_frames(golden), seeds=torch.arange(3), sampling=MmmSampling(temperature=0.0)
    )
    assert torch.equal(ids_of(result), golden["out.greedy_ids"])


def test_edit(golden_file):
    golden = read(golden_file, "generate")
    frames, given = whole_frames(golden), golden["in.token_cond"][:, :49]
    source = Latents(frames // 4, frames, codes=given.masked_fill(given == MASK, 0)[..., None])
    known = Known(source, given != MASK)
    result = load(golden_file).sample(
        text(golden), None, seeds=torch.arange(3), known=known, draws=Greedy(torch.arange(3))
    )
    assert torch.equal(ids_of(result), golden["out.edit_ids"])


class RecordedGumbel:
    """Draw as recorded: the likeliest code after Gumbel noise."""

    def __init__(self, uniform: Tensor) -> None:
        self.uniform = uniform

    def order(self, size: int) -> Tensor:
        """Give nothing: MMM has no order."""
        raise AssertionError("MMM draws no order")

    def pick(self, step: int, logits: Tensor) -> Tensor:
        """Add this step's noise."""
        inner = self.uniform[step, :, : logits.shape[1]].clamp(min=1e-20).log()
        return (logits - (-inner).clamp(min=1e-20).log()).argmax(-1)


def test_generation_with_recorded_noise(golden_file):
    golden = read(golden_file, "generate")
    draws = RecordedGumbel(golden["rng.gumbel_uniform"])
    result = load(golden_file).sample(text(golden), whole_frames(golden), seeds=torch.arange(3), draws=draws)
    assert torch.equal(ids_of(result), golden["out.gumbel_ids"])


@pytest.mark.parametrize(("frames", "row", "steps"), [(44, 2, 1), (96, 1, 5)])
def test_a_batch_of_one_stops_early_as_published(golden_file, frames, row, steps):
    """Run as many steps as the published code does for one sample: S, but 1 where S = 2 (BAD §4). We run all ten."""
    golden, model = read(golden_file, "generate"), load(golden_file)
    lengths, one = torch.tensor([frames // 4]), text(golden, slice(row, row + 1))
    free = frame_mask(lengths, frames // 4)
    counts = shrinking_counts(lengths, 10)

    @torch.no_grad()
    def predict(codes: Tensor, masked: Tensor, step: int) -> Tensor:
        return model(codes.masked_fill(masked, MASK), one, lengths)[:, 1:-1]

    def decode(counts: Tensor) -> Tensor:
        *_, (_, codes) = unmask_tokens(free.long(), free, counts, predict, Greedy(lengths).pick)
        return ids_of(Latents(lengths, lengths * 4, codes=codes[..., None]))

    assert torch.equal(decode(counts[:steps]), golden[f"out.single_{frames}frames_ids"])
    sampled = model.sample(one, lengths * 4, seeds=lengths, sampling=MmmSampling(temperature=0.0))
    assert torch.equal(decode(counts), ids_of(sampled))


def test_export_writes_the_published_keys(golden_file):
    published, exported = state(golden_file), mmm.export(load(golden_file))
    own = {k for k in published if not k.startswith("trans_base.vqvae.") or k.endswith("quantizer.codebook")}
    assert set(exported) == own
    for key in own - {"trans_base.pos_embedding.weight"}:  # unused, any value will do
        torch.testing.assert_close(exported[key], published[key], **CLOSE)


def test_the_tokenizer_in_the_file_has_the_same_codebook(golden_file):
    tokenizer = interop.load("mmm-vq", {"net": bad.tokenizer(state(golden_file))})
    assert torch.equal(tokenizer.codebook, load(golden_file).codebook)
