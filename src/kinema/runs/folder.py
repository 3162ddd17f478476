"""Keep run folders: where their files are, how far the run is, and who works on it."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinema.atomic import write_json
from kinema.files.json import NUMBER, Kind, read_json
from kinema.locks import attempt, hold
from kinema.runs.console import console
from kinema.signals import Interrupted, interruptible

MOST = 1 << 20
"""Bytes that a file about a run may have."""

STATUS = {
    "state": str,
    "error": str | None,
    "step": int | None,
    "seconds": NUMBER | None,
    "val_loss": NUMBER | None,
    "parameters": int | None,
    "device": str | None,
    "versions": dict | None,
}


@dataclass(frozen=True)
class RunFolder:
    """Hold one run: config.yaml, status.json, checkpoints/, its weights, metrics.jsonl, samples/."""

    path: Path

    @property
    def status(self) -> dict[str, Any]:
        """What status.json says, or `pending` where there is none."""
        return read_about(self.path / "status.json", STATUS) or {"state": "pending"}

    @property
    def done(self) -> bool:
        """Say whether the run has its weights."""
        return self.status["state"] == "done" and self.weights.exists()

    @property
    def weights(self) -> Path:
        """Name the weights file."""
        return self.path / "weights.safetensors"

    def mark(self, state: str, **values: Any) -> None:
        """Record the state: pending | running | partial | done | failed | interrupted."""
        kept = {k: v for k, v in self.status.items() if k != "error"}
        write_json(self.path / "status.json", {**kept, "state": state, **values})

    @contextmanager
    def marked_by_failure(self) -> Iterator[None]:
        """Record that what is done inside failed, or was interrupted, and why."""
        try:
            with interruptible():
                yield
        except Interrupted as stop:
            self.mark("interrupted", error=str(stop))
            console.print(f"[yellow]stopped[/]   {self.path!s}: {stop}")
            stop.told = True
            raise
        except BaseException as error:
            self.mark("failed", error="".join(traceback.format_exception_only(error)).strip())
            raise

    def lock(self) -> AbstractContextManager[None]:
        """Hold the run for this process; a second process waits (the system frees the lock of a killed one)."""
        told = f"waiting   {self.path}: another process works on it"
        return hold(self.path / ".lock", waiting=lambda: console.print(told))

    @property
    def held(self) -> bool:
        """Say whether a process works on the run: it holds one of its locks."""
        for lock in (self.path / ".lock", *self.path.glob(".replication-*.lock")):
            if lock.exists():
                try:
                    with attempt(lock) as free:
                        if not free:
                            return True
                except OSError:  # a folder of somebody else's
                    return True
        return False


def read_about(path: Path, kind: Kind) -> dict[str, Any]:
    """Read a run's small JSON object; a missing file is an empty one."""
    if not path.exists():
        return {}
    fix = "the file is damaged: delete this run folder, and train or import the run again"
    return read_json(path, kind, most=MOST, fix=fix)
