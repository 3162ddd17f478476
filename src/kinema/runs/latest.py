"""Find a run by what it is: `latest:mardm_sit` is the last one of that name that finished."""

from __future__ import annotations

import os
from pathlib import Path

from kinema.runs.console import console
from kinema.runs.folder import RunFolder

LATEST = "latest:"


def find_run(run: str | Path, root: str | Path | None = None) -> Path:
    """Return the folder of a run: `latest:NAME` is looked up among the finished runs, anything else is a path.

    NAME is the first word of the folder's name, further ones (`latest:mardm_sit-tiny-s1`) and the stage
    (`latest:generator/mardm_sit`) narrow it down. `root` is the folder of runs: KINEMA_RUNS, else runs, if left out.
    Raises FileNotFoundError naming what there is.
    """
    if not str(run).startswith(LATEST):
        return Path(run)
    root = Path(root or os.environ.get("KINEMA_RUNS", "runs"))
    wanted = str(run).removeprefix(LATEST)
    stage, _, name = wanted.rpartition("/")
    who, *words = name.split("-")
    finished = [file.parent for file in root.glob("*/*/status.json") if _done(RunFolder(file.parent))]
    found = [
        folder
        for folder in finished
        if stage in ("", folder.parent.name)
        and folder.name.split("-")[0] == who
        and set(words) <= set(folder.name.split("-"))
    ]
    if not found:
        known = sorted({f"{folder.parent.name}/{folder.name.rpartition('-')[0]}" for folder in finished})
        there = f"finished there: {', '.join(known)}" if known else "no run has finished there"
        raise FileNotFoundError(
            f"{root.absolute()} holds no finished run {wanted!r} ({there}); train it, or give a run's folder"
        )
    return max(found, key=lambda folder: (folder / "status.json").stat().st_mtime_ns)


def _done(run: RunFolder) -> bool:
    """Say whether a run finished; of one that is damaged, that it is left out."""
    try:
        return run.done
    except (ValueError, OSError) as error:
        console.print(f"[yellow]note[/]      {error!s}; left out")
        return False
