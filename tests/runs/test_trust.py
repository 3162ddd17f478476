"""A weights file builds what is marked as buildable, as large as its tensors are, and touches nothing else."""

from __future__ import annotations

import importlib
import json
import socket
import sys

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from kinema.registry import buildable
from kinema.runs import weights
from kinema.runs.build import build

REPRESENTATION = {
    "_target_": "kinema.motion.representation.Representation",
    "kind": "essential",
    "skeleton": "humanml3d",
}
AUTOENCODER = {
    "_target_": "kinema.tokenizers.autoencoder.AutoEncoder",
    "representation": REPRESENTATION,
    "width": 8,
    "latent_dim": 4,
}
FOREIGN = [
    {"_target_": "kinema.data.packing.StoreWriter", "folder": ".", "name": "x", "skeleton": "x", "tag_fps": 20},
    {"_target_": "kinema.text.packed.PackedFeatures", "folder": ".", "identity": "x", "dim": 1, "token_dim": 1,
     "token_dtype": None},
    {"_target_": "kinema.text.clip.ClipTextEncoder", "name": "clip_b32", "path": "someone/else"},
    {"_target_": "kinema.text.minilm.MiniLMTextEncoder", "path": "."},
    {"_target_": "kinema.runs.weights.Path", "path": "x"},
    {"_target_": "kinema.runs.folder.RunFolder", "path": "x"},
    {"_target_": "kinema.training.fit.Trainer"},
    {"_target_": "kinema.training.record.Record", "folder": ".", "dashboards": []},
    {"_target_": "kinema.data.store.PackedStore", "path": "."},
    {"_target_": "kinema.text.cache.CachedTextEncoder", "encoder": None, "directory": "."},
    {"_target_": "kinema.tokenizers.MotionTokenizer"},
    {"_target_": "kinema.generators.Generator"},
    {"_target_": "kinema.motion.representation.nn.Module"},
    {"_target_": "kinema.cli.__main__.main"},
    {"_target_": "kinema.cli.main"},
    {"_target_": "torch.nn.Linear", "in_features": 1, "out_features": 1},
    {"_target_": "lightning.Trainer"},
    {"_target_": "os.system", "command": "touch x"},
    {"_target_": "builtins.exec"},
    {"_target_": "antigravity.webbrowser"},
    {"_target_": "kinema.nothing.Here"},
    {"_target_": "kinema..x"},
    {"_target_": "kinema."},
    {"_target_": "kinema"},
    {"_target_": "."},
    {"_target_": ""},
    {"_target_": None},
    {"_target_": 3},
    {"_target_": ["kinema.diffusion.flow.Flow"]},
    {"_target_": "\x1b[31mkinema.diffusion.flow.Flow"},
]  # fmt: skip


def hostile(path, spec, state=None):
    """Write a weights file by hand, as somebody else may."""
    header = json.dumps({"kinema": "0", "spec": spec})
    save_file(state or {"a": torch.zeros(1)}, path, metadata={"kinema": header})
    return path


@pytest.fixture
def offline(monkeypatch, tmp_path):
    """Stand in an empty folder without a network."""

    def refuse(*_, **__):
        pytest.fail("the network was asked for")

    monkeypatch.setattr(socket, "create_connection", refuse)
    monkeypatch.setattr(socket.socket, "connect", refuse)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path


@pytest.mark.parametrize("spec", FOREIGN, ids=lambda spec: repr(spec["_target_"]))
@pytest.mark.parametrize("nested", [False, True], ids=["outermost", "argument"])
def test_a_class_that_is_not_marked_is_never_made(offline, spec, nested):
    file = hostile(offline / "weights.safetensors", {**AUTOENCODER, "representation": spec} if nested else spec)
    with pytest.raises(
        ValueError, match=r"weights\.safetensors: _target_=.*no class that is marked @buildable"
    ) as told:
        weights.load(file)
    assert "\x1b" not in str(told.value)
    assert "antigravity" not in sys.modules
    assert not list((offline / "here").iterdir())


@pytest.mark.parametrize("name", [k for k in AUTOENCODER if k not in ("_target_", "representation")] + ["depth"])
@pytest.mark.parametrize("value", [10**9, 10**30, 1e308, -(10**9), 0, -1, 2.5, "many", None, [8], {"a": 8}, True])
def test_what_does_not_fit_the_tensors_is_refused_before_memory_is_asked_for(tmp_path, name, value):
    state = build(AUTOENCODER).state_dict()
    with pytest.raises(ValueError, match=r"weights\.safetensors"):
        weights.load(hostile(tmp_path / "weights.safetensors", {**AUTOENCODER, name: value}, state))


@buildable
class Deep(nn.Module):
    """Make as many layers as are asked for."""

    def __init__(self, layers: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(nn.Linear(1, 1) for _ in range(layers))


@buildable
class Wide(nn.Module):
    """Hold a table that is computed, not saved."""

    def __init__(self, places: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(1))
        self.register_buffer("table", torch.zeros(places, places), persistent=False)


def test_layers_and_tables_without_end_are_given_up(tmp_path):
    def load(spec, state):
        return weights.load(hostile(tmp_path / "weights.safetensors", spec, state))

    here = sys.modules[__name__]
    assert len(load({"_target_": f"{here.__name__}.Deep", "layers": 2}, Deep(2).state_dict())[0].layers) == 2
    with pytest.raises(ValueError, match="far more than its weights hold"):
        load({"_target_": f"{here.__name__}.Deep", "layers": 99_999}, Deep(2).state_dict())
    with pytest.raises(ValueError, match="asks for buffers"):
        load({"_target_": f"{here.__name__}.Wide", "places": 90_000}, {"weight": torch.zeros(1)})


def test_a_package_of_ones_own_is_built_once_it_is_imported(tmp_path, monkeypatch):
    (tmp_path / "ownpackage.py").write_text(
        "from torch import nn\nfrom kinema.registry import buildable\n\n\n"
        "@buildable\nclass Own(nn.Linear):\n    pass\n\n\nclass Unmarked(Own):\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    spec = {"_target_": "ownpackage.Own", "in_features": 2, "out_features": 3}
    with pytest.raises(ValueError, match="import that first"):
        build(spec)
    assert "ownpackage" not in sys.modules
    try:
        importlib.import_module("ownpackage")
        assert build(spec).weight.shape == (3, 2)
        with pytest.raises(ValueError, match="no class that is marked"):
            build({**spec, "_target_": "ownpackage.Unmarked"})
    finally:
        sys.modules.pop("ownpackage", None)
