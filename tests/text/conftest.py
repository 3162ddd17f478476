"""Make a tiny CLIP: random weights and a BPE of single letters, saved in the layout of the published folders."""

from __future__ import annotations

import json
import string
from pathlib import Path

import pytest
import torch


@pytest.fixture(scope="session")
def tiny_clip(tmp_path_factory) -> Path:
    transformers = pytest.importorskip("transformers")
    folder = tmp_path_factory.mktemp("tiny-clip")
    letters = list(string.ascii_lowercase)
    vocabulary = [*letters, *(c + "</w>" for c in letters), "wa", "<|startoftext|>", "<|endoftext|>"]
    torch.manual_seed(0)
    shape = {"intermediate_size": 64, "num_hidden_layers": 2, "num_attention_heads": 2, "projection_dim": 24}
    text = {"hidden_size": 32, "vocab_size": len(vocabulary), "max_position_embeddings": 77, **shape}
    # As in the published files, the end token's id in the config is the legacy 2: the model then takes the argmax.
    text |= {"eos_token_id": 2, "bos_token_id": 0, "pad_token_id": 1}
    vision = {"hidden_size": 32, "image_size": 32, "patch_size": 16, **shape}
    config = transformers.CLIPConfig(text_config=text, vision_config=vision, projection_dim=24)
    transformers.CLIPModel(config).save_pretrained(folder)
    (folder / "vocab.json").write_text(json.dumps({t: i for i, t in enumerate(vocabulary)}))
    (folder / "merges.txt").write_text("#version: 0.2\nw a\n")
    special = {"bos_token": "<|startoftext|>", "eos_token": "<|endoftext|>", "pad_token": "<|endoftext|>"}
    names = {"tokenizer_class": "CLIPTokenizer", "unk_token": "<|endoftext|>", "model_max_length": 77}
    (folder / "tokenizer_config.json").write_text(json.dumps(special | names))
    return folder
