"""Save a module with the spec that rebuilds it as one safetensors file, and load it back anywhere.

The header holds one JSON entry, `kinema`: `{"kinema": version, "spec": {"_target_": ...}, ...what the caller adds}`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor, nn

from kinema import __version__
from kinema.atomic import replacing
from kinema.files.checkpoints import read_header, read_safetensors
from kinema.files.json import parse_json
from kinema.runs.build import build
from kinema.runs.sketch import check_spec

HEADER = {"kinema": str, "spec": dict, "part": str | None}
FIX = "write or download it again"


def save(module: nn.Module, spec: dict[str, Any], path: str | Path, *, half: bool = False, **meta: Any) -> Path:
    """Write the module's tensors, its spec and `meta` (plain containers), whole or not at all.

    `half` writes parameters in half precision; buffers (statistics, codebooks) stay as they are, and `load` gives
    single precision again. Raises ValueError for a spec that is not plain data or a weight that half can't hold,
    OSError (naming the path) if the disk refuses.
    """
    path = Path(path)
    state = _halved(module) if half else module.state_dict()
    try:
        header = json.dumps({"kinema": __version__, "spec": spec, **meta}, sort_keys=True)
    except TypeError as error:
        raise ValueError(
            f"spec and metadata of {path} must be plain dicts, lists, strings and numbers: {error}"
        ) from None
    try:
        with replacing(path, sync=True) as temporary:
            save_file(_separate(state), temporary, metadata={"kinema": header})
    except (OSError, SafetensorError) as error:
        raise OSError(f"could not write {path}: {error}; free disk space or choose another folder") from error
    return path


def load(path: str | Path, device: torch.device | str = "cpu") -> tuple[nn.Module, dict[str, Any]]:
    """Rebuild a saved module in eval mode and give it with its metadata; the spec is also kept as `module.spec`.

    Raises FileNotFoundError, or ValueError for a file that is damaged, foreign or of another version of a class.
    """
    path = _there(path)
    state, header = read_safetensors(path, fix=FIX)
    meta = _meta(path, header)
    # Initial values are drawn and then overwritten: the caller's random state must not notice.
    with torch.random.fork_rng(devices=[]):
        check_spec(meta["spec"], state, path)
        module = build(meta["spec"], at=f"{path}: spec")
    try:
        module.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(
            f"the weights in {path}, written by kinema {meta['kinema']}, do not fit version {__version__}: {error}"
        ) from None
    module.spec = meta["spec"]
    return module.to(device).eval(), meta


def read_meta(path: str | Path) -> dict[str, Any]:
    """Read the metadata alone: milliseconds, whatever the size of the weights."""
    path = _there(path)
    return _meta(path, read_header(path, fix=FIX))


def _there(path: str | Path) -> Path:
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no weights at {path}; train this stage first or check the path")
    return path


def _meta(path: Path, header: dict[str, str]) -> dict[str, Any]:
    if "kinema" not in header:
        raise ValueError(
            f"{path} was not written by kinema (no spec in its header); "
            "load a published checkpoint with `kinema import KIND FILE --out RUN`"
        )
    return parse_json(header["kinema"], f"{path}: its header", HEADER, fix=FIX)


def _halved(module: nn.Module) -> dict[str, Tensor]:
    """Return the state with its parameters in half precision."""
    state = dict(module.state_dict())
    for name, parameter in module.named_parameters(remove_duplicate=False):
        state[name] = parameter.detach().half()
        if not state[name].isfinite().all():
            raise ValueError(
                f"half precision can't hold {name!r}, of up to {parameter.abs().max():.3g}; write it whole"
            )
    return state


def _separate(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """Make every tensor contiguous and copy those that share memory, which the format has no word for."""
    seen: set[int] = set()
    result = {}
    for key, value in state.items():
        value = value.detach().contiguous()
        storage = value.untyped_storage()
        shared = storage.data_ptr() in seen or storage.nbytes() != value.nbytes
        seen.add(storage.data_ptr())
        result[key] = value.clone() if shared else value
    return result
