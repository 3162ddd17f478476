"""Keep what a run says of itself while it trains: numbers and samples by step, on disk and in its dashboards."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from kinema.atomic import write_text
from kinema.files.json import NUMBER
from kinema.runs.lines import append_line, read_lines
from kinema.training.dashboards import Dashboard

LINE = {"step": int, "seconds": NUMBER | None}
"""What a line of metrics.jsonl holds, beside its numbers."""


class Record:
    """Append to `metrics.jsonl` and keep `samples/`; the dashboards show the same at the same steps.

    A run that resumes drops what is of later steps, and shows the rest anew. `seconds` are counted over interruptions.
    """

    def __init__(self, folder: Path, dashboards: Sequence[Dashboard] = ()) -> None:
        self.folder, self.dashboards = folder, dashboards
        self.spent, self.started = 0.0, time.monotonic()

    @property
    def seconds(self) -> float:
        """The seconds of training up to now, earlier parts of the run included."""
        return self.spent + time.monotonic() - self.started

    @property
    def path(self) -> Path:
        """Name the file of the numbers."""
        return self.folder / "metrics.jsonl"

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Keep numbers of a step."""
        append_line(self.path, {"step": step, "seconds": round(self.seconds, 2), **values})
        for dashboard in self.dashboards:
            dashboard.scalars(step, values)

    def sample(self, step: int, suffix: str, name: str = "samples") -> Path:
        """Name the file of a step's sample."""
        folder = self.folder / "samples"
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"step-{step:07d}{'' if name == 'samples' else f'-{name}'}{suffix}"

    def samples(self, step: int | None = None) -> list[Path]:
        """Return the files of a step, or of all of them in order."""
        found = sorted((self.folder / "samples").glob("step-*"), key=lambda path: (_step(path), path.name))
        return [path for path in found if step in (None, _step(path))]

    def show(self, path: Path) -> None:
        """Show a sample that was written."""
        _, step, *name = path.stem.split("-")
        for dashboard in self.dashboards:
            dashboard.show(int(step), "-".join(name) or "samples", path)

    def rewind(self, step: int) -> None:
        """Go back to a step: the lines and samples of later ones are dropped, the others shown."""
        lines = [line for line in read_lines(self.path, LINE) if line["step"] <= step]
        write_text(self.path, "".join(json.dumps(line, sort_keys=True) + "\n" for line in lines))
        for path in self.samples():
            if _step(path) > step:
                path.unlink()
        self.replay()
        self.started = time.monotonic()

    def replay(self) -> None:
        """Show all that there is, in the order of steps (wandb takes no earlier one after a later)."""
        if not self.dashboards:
            return
        samples = self.samples()
        for line in sorted(read_lines(self.path, LINE), key=lambda line: line["step"]):
            while samples and _step(samples[0]) < line["step"]:
                self.show(samples.pop(0))
            values = {key: value for key, value in line.items() if key not in ("step", "seconds")}
            for dashboard in self.dashboards:
                dashboard.scalars(line["step"], values)
        for path in samples:
            self.show(path)


def _step(path: Path) -> int:
    return int(path.stem.split("-")[1])
