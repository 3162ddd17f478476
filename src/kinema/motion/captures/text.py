"""Read the text of capture files, whatever wrote their comments."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

MOST_BYTES = 2**30


def read_text(path: Path) -> str:
    """Read a file of ASCII words; names of other encodings in comments don't matter (latin-1 reads every byte)."""
    if not path.is_file():
        raise FileNotFoundError(f"no such file: {path}")
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size / 2**30:.1f} GiB; a capture of more than 1 GiB isn't read")
    content = path.read_bytes()
    if b"\0" in content[:4096]:
        raise ValueError(f"{path} is a binary file, no text; convert it to BVH or AMC first")
    return content.decode("latin-1")


def numbers(path: Path, words: list[str], what: str) -> Float[np.ndarray, " n"]:
    """Turn words into finite numbers."""
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError as error:
        raise ValueError(f"{path} has something else than numbers in {what}: {error}") from None
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise ValueError(f"{path} has {words[bad[0]]} in {what} (number {bad[0] + 1}); only finite numbers are motion")
    return values
