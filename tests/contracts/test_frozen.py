"""Frozen parts stay frozen while a generator trains: no gradient, dropout, averaging or update reaches them."""

from __future__ import annotations

import pytest
import torch
from lightning.pytorch import Callback
from torch import nn

from kinema.data.datamodule import MotionDataModule
from kinema.data.datasets import ClipDataset
from kinema.text.clip import ClipTextEncoder
from kinema.training.callbacks import EMA
from kinema.training.fit import fit
from kinema.training.latents import EncodeEachTime, latent_source
from kinema.training.machine import Machine
from kinema.training.modules import GeneratorModule
from kinema.training.recipe import Recipe

STEPS = 3


class Watch(Callback):
    """Look at the frozen parts while the generator is in training."""

    def __init__(self, frozen: dict[str, nn.Module]) -> None:
        self.frozen, self.steps = frozen, 0

    def on_before_zero_grad(self, trainer, module, optimizer) -> None:
        self.look(trainer, module, optimizer)

    def on_train_batch_end(self, trainer, module, *_) -> None:
        module.train()
        self.look(trainer, module, trainer.optimizers[0])
        self.steps += 1

    def look(self, trainer, module, optimizer) -> None:
        assert module.model.training
        (average,) = [c for c in trainer.callbacks if isinstance(c, EMA)]
        learnt = {id(p) for group in optimizer.param_groups for p in group["params"]}
        learnt |= {id(p) for p in average.averaged().parameters()} | {id(p) for p in module.parameters()}
        for name, part in self.frozen.items():
            assert not any(m.training for m in part.modules()), name
            assert all(p.grad is None and id(p) not in learnt for p in part.parameters()), name


@pytest.mark.parametrize("cached", [True, False])
@pytest.mark.filterwarnings("ignore")
def test_nothing_touches_the_autoencoder_and_the_text_encoder(workshop, make_clip, tmp_path, cached):
    text = ClipTextEncoder("clip_b32", make_clip(64, 64))
    vae = workshop.make("tokenizer", "method=mld", "tokenizer.model.dropout=0.5")
    model = workshop.make("generator", "method=mld", "generator.model.dropout=0.5")
    model.take_empty_text(text.empty())
    clips = [ClipDataset(workshop.store, split) for split in ("train", "val")]
    vae.requires_grad_(False)  # as the stage reads it
    source = latent_source(tmp_path / "latents", vae, clips, "cpu") if cached else EncodeEachTime(vae, clips)
    frozen = {"autoencoder": vae, "text encoder": text.model}
    before = {name: {k: v.clone() for k, v in part.state_dict().items()} for name, part in frozen.items()}
    batch = workshop.clips()
    latents, words = source(batch).values, text(batch.texts).pooled
    recipe = Recipe(steps=STEPS, batch_size=4, ema=0.9, validate_every=2, checkpoint_every=100, val_batches=1)
    module, watch = GeneratorModule(model, recipe, 0, source, text), Watch(frozen)
    assert {key.split(".")[0] for key in module.state_dict()} == {"model"}
    assert not any(part is held for part in frozen.values() for held in module.modules())
    data = MotionDataModule(workshop.path, kind="clips", batch_size=4, steps=STEPS)
    start = {k: v.clone() for k, v in model.state_dict().items()}
    fitted = fit(module, data, tmp_path, Machine(accelerator="cpu", progress="none"), callbacks=[watch])
    assert watch.steps == STEPS
    for name, part in frozen.items():
        assert all(torch.equal(v, part.state_dict()[k]) for k, v in before[name].items()), name
    assert torch.equal(source(batch).values, latents)  # dropout would show
    assert torch.equal(text(batch.texts).pooled, words)
    assert torch.equal(fitted.weights["empty_text"], start["empty_text"])
    assert not torch.equal(fitted.weights["denoiser.positions"], start["denoiser.positions"])
