"""Keep run folders: status, lock, results; everything is written whole or not at all."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import platform
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rich.console import Console

console = Console(highlight=False, soft_wrap=True)


def write_json(path: Path, value: Any) -> None:
    """Write JSON through a temporary file and a rename."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(json.dumps(value, indent=1, sort_keys=True) + "\n")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@dataclass(frozen=True)
class RunFolder:
    """Hold one run: config.yaml, status.json, checkpoints/, weights.safetensors, metrics.jsonl, samples/."""

    path: Path

    @property
    def status(self) -> dict[str, Any]:
        """Status.json, or `pending` where there is none."""
        file = self.path / "status.json"
        try:
            return json.loads(file.read_text()) if file.exists() else {"state": "pending"}
        except json.JSONDecodeError as error:
            raise ValueError(f"{file} is damaged ({error}); delete this run folder to train it again") from None

    @property
    def done(self) -> bool:
        """Say whether the run has its weights."""
        return self.status["state"] == "done" and self.weights.exists()

    @property
    def weights(self) -> Path:
        """Name the weights file."""
        return self.path / "weights.safetensors"

    def mark(self, state: str, **values: Any) -> None:
        """Record the state: pending | running | done | failed."""
        kept = {k: v for k, v in self.status.items() if k != "error"}
        write_json(self.path / "status.json", {**kept, "state": state, **values})

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the run for this process; a second process waits (the system frees the lock of a killed one)."""
        self.path.mkdir(parents=True, exist_ok=True)
        with open(self.path / ".lock", "w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                console.print(f"waiting   {self.path}: another process works on it")
                fcntl.flock(file, fcntl.LOCK_EX)
            yield


def global_rank() -> int:
    """Return this process' rank as torchrun, Slurm or Lightning's launcher set it; 0 where nothing did."""
    # SLURM_PROCID may be set (to 0) where Slurm does not start the ranks, as in an interactive shell.
    for name in ("RANK", "LOCAL_RANK", "SLURM_PROCID"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return 0


def versions() -> dict[str, str]:
    """Name what computed a result: packages, Python and the revision of the checkout."""
    found = {"python": platform.python_version()}
    for package in ("kinema", "torch", "lightning", "numpy", "transformers"):
        with contextlib.suppress(PackageNotFoundError):
            found[package] = version(package)
    root = Path(__file__).resolve().parents[3]
    if not (root / "pyproject.toml").exists():
        return found  # installed: git would answer for whatever repository site-packages happens to lie in
    with contextlib.suppress(OSError):
        answer = subprocess.run(["git", "-C", root, "describe", "--always", "--dirty"], capture_output=True, text=True)
        if answer.returncode == 0:
            found["revision"] = answer.stdout.strip()
    return found


def upstream(run: Path) -> dict[str, Path]:
    """Read which runs a run was trained on (its upstream.json; links are relative to the run)."""
    file = run / "upstream.json"
    links = json.loads(file.read_text()) if file.exists() else {}
    return {name: (run / link).resolve() for name, link in links.items()}


def append_line(path: Path, value: dict[str, Any]) -> None:
    """Append one JSON line, ending a torn last line first so that it can't swallow this one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    torn = path.exists() and path.stat().st_size > 0 and not path.read_bytes().endswith(b"\n")
    with open(path, "a") as file:
        file.write(("\n" if torn else "") + json.dumps(value, sort_keys=True) + "\n")
        file.flush()
        os.fsync(file.fileno())


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Read JSON lines; a torn line (a killed process) is named and left out."""
    lines = []
    for number, text in enumerate(path.read_text().splitlines() if path.exists() else [], 1):
        if not text.strip():
            continue
        try:
            lines.append(json.loads(text))
        except json.JSONDecodeError:
            console.print(f"[yellow]warning[/]   {path}:{number} is not a whole line (a killed process?); left out")
    return lines
