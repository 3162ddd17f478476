"""Compare MARDM-DDPM and MARDM-SiT with the published modules, their random draws injected."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from kinema import interop
from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.diffusion.guidance import guided
from kinema.generators.mar.model import MARDM, MarSampling
from kinema.generators.mar.training import MarDraws
from kinema.generators.texts import without_text
from kinema.interop import mardm
from kinema.nn.diffusion_mlp import DiffusionMLP
from kinema.nn.embeddings import timestep_embedding
from kinema.types import Known, Latents, TextFeatures

VARIANTS = ("ddpm", "sit")
PROCESSES = {"ddpm": DDPM, "sit": Flow}
CLOSE = {"rtol": 1e-4, "atol": 1e-5}
STEPS = 6


def read(golden_file, name: str) -> dict[str, Tensor]:
    return load_file(golden_file(f"mardm/mardm_{name}.safetensors"))


def state(golden: dict[str, Tensor]) -> dict[str, Tensor]:
    return {k.removeprefix("sd."): v for k, v in golden.items() if k.startswith("sd.")}


def load_model(golden_file, variant: str) -> MARDM:
    golden = read(golden_file, f"{variant}_transformer")
    return interop.load("mardm", {"ema_mardm": state(golden)}, variant=variant, heads=4, max_latents=10)


def load_mlp(golden_file, variant: str) -> DiffusionMLP:
    golden = state(read(golden_file, f"{variant}_mlp"))
    mlp = DiffusionMLP(latent_dim=16, condition_dim=32, width=48, depth=3)
    mlp.load_state_dict({ours: golden[theirs] for theirs, ours in mardm.mlp_names(3).items()})
    return mlp.requires_grad_(False)


@pytest.mark.parametrize("variant", VARIANTS)
def test_transformer(golden_file, variant):
    golden, model = read(golden_file, f"{variant}_transformer"), load_model(golden_file, variant)
    latents, text, real = golden["in.latents"], golden["in.cond"], ~golden["in.padding_mask"]
    text = TextFeatures([""] * len(text), text)
    for name, made in (
        ("z", model(latents, text, real)),
        ("z_uncond", model(latents, without_text(text), real)),
        ("z_hard_reorder", model(latents, text, real, golden["in.reorder_mask"])),
    ):  # padding isn't computed
        torch.testing.assert_close(made, golden[f"out.{name}"] * real[..., None], **CLOSE)


@pytest.mark.parametrize("variant", VARIANTS)
def test_diffusion_mlp(golden_file, variant):
    golden, mlp = read(golden_file, f"{variant}_mlp"), load_mlp(golden_file, variant)
    x, t, c = golden["in.x"], golden["in.t"], golden["in.c"]
    outputs = []
    for block in mlp.blocks:
        block.register_forward_hook(lambda *call: outputs.append(call[-1]))
    torch.testing.assert_close(mlp(x, t, c), golden["out.eps_or_v"], **CLOSE)
    for i, output in enumerate(outputs):
        torch.testing.assert_close(output, golden[f"out.block{i}"], **CLOSE)
    torch.testing.assert_close(timestep_embedding(t), golden["out.timestep_embedding"], **CLOSE)
    torch.testing.assert_close(mlp.embed_time(t), golden["out.time_embed"], **CLOSE)
    together = guided(lambda x, _, c: mlp(x, t, c), c[:3], c[3:], 4.5)(x[:3], t)
    torch.testing.assert_close(together, golden["out.cfg4.5"][:3], **CLOSE)


@pytest.mark.parametrize("variant", VARIANTS)
def test_loss_per_row(golden_file, variant):
    golden, mlp, process = read(golden_file, f"{variant}_loss"), load_mlp(golden_file, variant), PROCESSES[variant]()
    x1, t, noise = golden["in.x1"], golden["in.t"], golden["in.noise"]
    torch.testing.assert_close(process.add_noise(x1, t, noise), golden["out.x_t"], **CLOSE)
    loss = process.loss(lambda x, t: mlp(x, t, golden["in.c"]), x1, t, noise)
    torch.testing.assert_close(loss, golden["out.loss"], **CLOSE)


def spread(mask: Tensor, rows: Tensor) -> Tensor:
    """Put rows that repeat the masked positions as tiles (4 x m) at their positions (b, n, 4)."""
    full = rows.new_zeros(*mask.shape, 4, *rows.shape[1:])
    full[mask] = rows.unflatten(0, (4, -1)).transpose(0, 1)
    return full


@pytest.mark.parametrize("variant", VARIANTS)
def test_training_loss(golden_file, variant):
    golden, model = read(golden_file, f"{variant}_forward_loss"), load_model(golden_file, variant)
    lengths = golden["in.lens"]
    time, noise = ("05.randint", "06.randn_like") if variant == "ddpm" else ("06.rand", "05.randn_like")
    permutation = golden["rng.01.rand"].argsort(dim=1)
    count = (10 * torch.cos(golden["rng.00.uniform_"] * torch.pi / 2)).round().clamp(min=1)
    mask = (permutation < count[:, None]) & (torch.arange(10) < lengths[:, None])
    draws = MarDraws(
        mask_time=golden["rng.00.uniform_"],
        permutation=permutation,
        to_noise=golden["rng.02.bernoulli"],
        to_mask=golden["rng.04.bernoulli"],
        corruption=golden["rng.03.randn_like"],
        condition_drop=torch.zeros(3, dtype=torch.bool),
        diffusion_time=spread(mask, golden[f"rng.{time}"]),
        diffusion_noise=spread(mask, golden[f"rng.{noise}"]),
    )
    latents = Latents(lengths=lengths, frames=lengths * 4, values=golden["in.latents_BDl"].transpose(1, 2))
    loss = model.loss(latents, TextFeatures(["", "", ""], golden["in.cond"]), draws=draws)["loss"]
    torch.testing.assert_close(loss, golden["out.loss"], **CLOSE)


DDPM_SAMPLES = {
    "cfg": {},
    "cfg_temperature0.7": {"temperature": 0.7},
    "ddim_eta0": {"solver": "ddim"},
    "nocfg": {},
}


def guided_mlp(mlp: DiffusionMLP, z: Tensor, golden: dict[str, Tensor], name: str):
    """Give the initial noise and the guided (z holds both halves) or plain network of a recorded sample."""
    if name == "nocfg":
        return golden["rng.nocfg.noise0"], guided(mlp, z, None, 1.0)
    return golden["rng.cfg.noise0"], guided(mlp, z[:4], z[4:], 4.5)


@pytest.mark.filterwarnings("ignore:.*multiplies the error of epsilon")
@pytest.mark.parametrize("name", DDPM_SAMPLES)
def test_ddpm_samples(golden_file, name):
    golden, mlp, seen = read(golden_file, "ddpm_sample"), load_mlp(golden_file, "ddpm"), []
    start, predict = guided_mlp(mlp, golden["in.z"], golden, name)
    steps = golden["rng.nocfg.steps" if name == "nocfg" else "rng.cfg.steps"][:, : len(start)]

    def watched(x: Tensor, t: Tensor) -> Tensor:
        seen.append(x)
        return predict(x, t)

    result = DDPM().sample(watched, iter([start, *steps]), **DDPM_SAMPLES[name])
    expected = golden[f"out.{name}"][: len(start)]
    torch.testing.assert_close(result, expected, rtol=0, atol=1e-5 * expected.abs().max().item())
    if name == "cfg":
        trajectory = golden["out.cfg_trajectory"][:, :4]
        close = {"rtol": 1e-4, "atol": 1e-5 * trajectory.abs().max().item()}
        torch.testing.assert_close(torch.stack([*seen[1:], result]), trajectory, **close)


# dopri5 at its tolerance reacts to rounding by up to 1e-4 of the result: the README compares at 1e-3.
SIT_SAMPLES = {
    "cfg": ("dopri5", None, 1e-3),
    "nocfg": ("dopri5", None, 1e-3),
    "cfg_dopri5_tight": ("rk4", 200, 1e-5),
    "cfg_euler51": ("euler", 50, 1e-5),
    "cfg_heun226": ("heun", 25, 1e-5),
    "cfg_midpoint26": ("midpoint", 25, 1e-5),
    "cfg_rk411": ("rk4", 10, 1e-5),
}


@pytest.mark.parametrize("name", SIT_SAMPLES)
def test_sit_samples(golden_file, name):
    golden, mlp, calls = read(golden_file, "sit_sample"), load_mlp(golden_file, "sit"), []
    solver, steps, tolerance = SIT_SAMPLES[name]
    start, predict = guided_mlp(mlp, golden["in.z"], golden, name)

    def counted(x: Tensor, t: Tensor) -> Tensor:
        calls.append(t)
        return predict(x, t)

    expected = golden[f"out.{name}"][: len(start)]
    result = Flow().sample(counted, iter([start]), solver=solver, steps=steps)
    torch.testing.assert_close(result, expected, rtol=0, atol=tolerance * expected.abs().max().item())
    if name == "cfg":
        assert len(calls) == golden["out.cfg_nfe"]


def test_sit_sample_to_rounding_where_time_is_embedded_per_row(golden_file):
    """Show that the published matrix shapes give the published steps: nothing but rounding is between us."""
    golden, mlp = read(golden_file, "sit_sample"), load_mlp(golden_file, "sit")
    start, predict = guided_mlp(mlp, golden["in.z"], golden, "cfg")
    result = Flow().sample(lambda x, t: predict(x, t.expand(8)), iter([start]), solver="dopri5")
    torch.testing.assert_close(result, golden["out.cfg"][:4], **CLOSE)


class GoldenDraws:
    """Replay a recorded generation; any part of the rows of a step's published mask may be asked for."""

    def __init__(self, golden: dict[str, Tensor]) -> None:
        self.golden = golden

    def order(self) -> Tensor:
        return self.golden["rng.schedule"]

    def noise(self, step: int, mask: Tensor) -> Iterator[Tensor]:
        published = self.golden[f"trace.{step}.mask"]
        assert not (mask & ~published).any()
        rows = mask[published]
        yield self.golden[f"rng.{step}.noise0"][rows]
        yield from self.golden[f"rng.{step}.steps"][:, : len(rows)][:, rows]


def task(golden: dict[str, Tensor], kind: str) -> tuple[Tensor | None, Known | None]:
    """Give (frames, known) of a recorded generation or edit."""
    lengths = golden["in.lens"]
    if kind.startswith("generate"):
        return lengths * 4, None
    latents = Latents(lengths=lengths, frames=lengths * 4, values=golden["in.src_BDl"].transpose(1, 2))
    keep = ~golden["in.edit_mask"] if kind == "edit" else torch.zeros(3, 10, dtype=torch.bool)
    return None, Known(latents, keep)


# Not ("sit", False): dopri5's steps depend on all rows, so fewer rows give another result within its tolerance.
@pytest.mark.parametrize(("variant", "resample_all"), [("ddpm", True), ("ddpm", False), ("sit", True)])
@pytest.mark.parametrize("kind", ["generate", "generate_hard", "edit", "edit_free"])
def test_generation(golden_file, variant, kind, resample_all):
    """Reproduce generations and edits; sampling only the kept positions gives the same DDPM results."""
    golden, model = read(golden_file, f"{variant}_{kind}"), load_model(golden_file, variant)
    frames, known = task(golden, kind)
    sampling = MarSampling(
        steps=STEPS,
        guidance=4.5,
        solver="dopri5" if variant == "sit" else None,
        resample_all=resample_all,
        pseudo_reorder=kind == "generate_hard",
        edit_fraction=0.16 if kind == "edit_free" else None,
    )
    states = list(
        model.trajectory(
            TextFeatures(["", "", ""], golden["in.cond"]),
            frames,
            seeds=torch.zeros(3, dtype=torch.long),
            known=known,
            sampling=sampling,
            draws=GoldenDraws(golden),
        )
    )
    expected = golden["out.latents_BDl"].transpose(1, 2)
    tolerance = {"rtol": 1e-4, "atol": 1e-5 * expected.abs().max().item()}
    torch.testing.assert_close(states[-1][1].values, expected, **tolerance)
    assert not resample_all or len(states) == 1 + STEPS
    masks = [golden[f"trace.{i}.mask"] for i in range(STEPS)]
    for step, latents in states[1:]:
        assert torch.equal(step.masked, masks[step.index])
        kept = ~masks[step.index + 1] if step.index + 1 < STEPS else torch.ones_like(masks[0])
        reference = golden[f"trace.{step.index}.latents_out"]
        torch.testing.assert_close(latents.values[kept], reference[kept], **tolerance)


def test_sampling_kept_positions_only_changes_nothing_but_rounding(golden_file):
    """Sample the kept positions from the same random stream: relative difference 2.5e-6 (MARDM §12.1)."""
    golden, model = read(golden_file, "ddpm_generate"), load_model(golden_file, "ddpm")
    text = TextFeatures(["", "", ""], golden["in.cond"])
    results = [
        model.sample(
            text,
            golden["in.lens"] * 4,
            seeds=torch.zeros(3, dtype=torch.long),
            sampling=MarSampling(steps=STEPS, resample_all=resample_all),
            draws=GoldenDraws(golden),
        ).values
        for resample_all in (True, False)
    ]
    assert (results[0] - results[1]).norm() <= 2.5e-6 * results[0].norm()


def test_exported_sizes_are_the_published_ones(golden_file):
    manifest = json.loads(golden_file("mardm/mardm_state_dict_manifest.json").read_text())
    with torch.device("meta"):
        model = MARDM(latent_dim=512, text_dim=512, process=DDPM())
        exported = mardm.export(model)
    published = [keys for name, keys in manifest.items() if name.startswith("MARDM-")]
    assert published == [{k: list(v.shape) for k, v in exported.items()}] * 2
