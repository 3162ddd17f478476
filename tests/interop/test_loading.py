"""Published files load whatever their wrapper, and nothing else does: one clear error each, and no code runs."""

from __future__ import annotations

import os
import pickle

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from kinema import interop
from kinema.interop.checkpoint import read_checkpoint, unwrap
from kinema.motion.statistics import Statistics
from kinema.runs import weights
from kinema.types import MotionBatch


def conv(state, name, outputs, inputs, size):
    state[f"{name}.weight"], state[f"{name}.bias"] = torch.randn(outputs, inputs, size), torch.randn(outputs)


def blocks(state, name, width):
    for i in range(3):
        conv(state, f"{name}.model.{i}.conv1", width, width, 3)
        conv(state, f"{name}.model.{i}.conv2", width, width, 1)


@pytest.fixture
def published() -> dict[str, torch.Tensor]:
    """Give a tiny autoencoder's state dict under the published names (MARDM §9)."""
    torch.manual_seed(0)
    state, width, latent, features = {}, 8, 6, 67
    conv(state, "encoder.model.0", width, features, 3)
    conv(state, "decoder.model.0", width, latent, 3)
    for level in (2, 3):
        conv(state, f"encoder.model.{level}.0", width, width, 4)
        blocks(state, f"encoder.model.{level}.1", width)
        blocks(state, f"decoder.model.{level}.0", width)
        conv(state, f"decoder.model.{level}.2", width, width, 3)
    conv(state, "encoder.model.4", latent, width, 3)
    conv(state, "decoder.model.4", width, width, 3)
    conv(state, "decoder.model.6", features, width, 3)
    assert len(state) == 66
    return state


def weight(module) -> torch.Tensor:
    return module.state_dict()["encoder.stem.weight"]


def test_every_wrapper_and_format_gives_the_same_module(published, tmp_path):
    torch.save({"ae": published, "ep": 50, "best": np.float64(0.3)}, tmp_path / "latest.tar")
    torch.save({"ae": {f"module.{k}": v for k, v in published.items()}}, tmp_path / "parallel.pth")
    torch.save(published, tmp_path / "bare.pt", _use_new_zipfile_serialization=False)
    save_file(published, tmp_path / "weights.safetensors")
    for file in tmp_path.iterdir():
        module = interop.load("mardm-ae", file)
        assert torch.equal(weight(module), published["encoder.model.0.weight"]), file.name
        assert not module.training


def test_an_imported_module_survives_as_an_artifact(published, tmp_path):
    statistics = Statistics(np.zeros(67), np.full(67, 2.0))
    module = interop.load("mardm-ae", published, statistics=statistics)
    weights.save(module, module.spec, tmp_path / "weights.safetensors")
    again, _ = weights.load(tmp_path / "weights.safetensors")
    motion = MotionBatch(torch.randn(1, 16, 67), torch.tensor([16]))
    assert torch.equal(again.encode(motion).values, module.encode(motion).values)


def test_statistics_come_from_a_folder_or_files_or_not_at_all(published, tmp_path):
    np.save(tmp_path / "Mean.npy", np.arange(67.0))
    np.save(tmp_path / "Std.npy", np.full(67, 3.0))
    for source in (tmp_path, (tmp_path / "Mean.npy", tmp_path / "Std.npy")):
        module = interop.load("mardm-ae", published, statistics=source)
        assert module.representation.mean[5] == 5
    with pytest.raises(ValueError, match="no statistics"):
        interop.load("mardm-ae", published).encode(MotionBatch(torch.zeros(1, 8, 67), torch.tensor([8])))
    with pytest.raises(FileNotFoundError, match=r"Mean\.npy"):
        interop.load("mardm-ae", published, statistics=tmp_path / "nowhere")


def test_preferred_wrappers_come_first_and_the_text_encoder_is_left_out():
    content = {
        "mardm": {"a": torch.zeros(1)},
        "ema_mardm": {"a": torch.ones(1), "clip_model.x": torch.ones(1)},
        "ep": 1,
    }
    assert unwrap(content, ("ema_mardm", "mardm")) == {"a": torch.ones(1)}
    parts = unwrap(
        {"text_encoder": {"w": torch.ones(1)}, "motion_encoder": {"w": torch.zeros(1)}, "epoch": 3},
        ("text_encoder", "motion_encoder"),
        several=True,
    )
    assert sorted(parts) == ["motion_encoder.w", "text_encoder.w"]
    assert unwrap(parts, ("text_encoder", "motion_encoder"), several=True) == parts


class Malicious:
    """Make a file when unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize("write", [torch.save, lambda value, path: path.write_bytes(pickle.dumps(value))])
def test_code_in_a_file_is_named_and_never_runs(tmp_path, write):
    write({"ae": {}, "payload": Malicious(tmp_path / "ran")}, tmp_path / "latest.tar")
    with pytest.raises(ValueError, match=r"posix\.mkdir|more than tensors|cannot be read"):
        interop.load("mardm-ae", tmp_path / "latest.tar")
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("name", ["latest.tar", "old.tar", "weights.safetensors"])
@pytest.mark.parametrize("kept", [0, 7, 1000, -100])
def test_a_truncated_file_is_named(published, tmp_path, name, kept):
    file = tmp_path / name
    if name.endswith("safetensors"):
        save_file(published, file)
    else:
        torch.save({"ae": published}, file, _use_new_zipfile_serialization=name == "latest.tar")
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(ValueError, match=f"{name} .*(cannot be read|truncated|is empty)"):
        interop.load("mardm-ae", file)


def test_what_does_not_fit_is_listed(published):
    def broken(change):
        state = dict(published)
        change(state)
        with pytest.raises(ValueError, match="state dict is not that of a 'mardm-ae'") as error:
            interop.load("mardm-ae", state)
        return str(error.value)

    assert "1 missing: decoder.mix.bias" in broken(lambda s: s.pop("decoder.model.4.bias"))
    assert "1 unknown: quantizer.codebook" in broken(lambda s: s.update({"quantizer.codebook": torch.zeros(2, 2)}))
    assert "encoder.model.0.weight" in broken(lambda s: s.pop("encoder.model.0.weight"))
    message = broken(lambda s: s.update({"decoder.model.6.weight": torch.zeros(66, 8, 3)}))
    assert "decoder.head.weight (66, 8, 3) instead of (67, 8, 3)" in message
    many = broken(lambda s: [s.update({f"extra.{i}": torch.zeros(1)}) for i in range(9)])
    assert "9 unknown: extra.0" in many
    assert "extra.8" not in many


def test_wrong_requests_are_named(published, tmp_path):
    with pytest.raises(ValueError, match="unknown kind of checkpoint 'mardm_ae'; allowed: mardm-ae, t2m-gpt-vq"):
        interop.load("mardm_ae", published)
    with pytest.raises(ValueError, match="has no option 'widht'; allowed: statistics"):
        interop.load("mardm-ae", published, widht=3)
    with pytest.raises(ValueError, match="expected the entry ae, the file holds net, ep"):
        interop.load("mardm-ae", {"net": published, "ep": 3})
    with pytest.raises(ValueError, match="width 66; known: 67, 263"):
        interop.load("mardm-ae", {**published, "encoder.model.0.weight": torch.zeros(8, 66, 3)})
    with pytest.raises(FileNotFoundError, match="no checkpoint file at"):
        interop.load("mardm-ae", tmp_path / "nothing.tar")
    torch.save([1, 2], tmp_path / "list.pt")
    with pytest.raises(ValueError, match="holds a list"):
        read_checkpoint(tmp_path / "list.pt")
