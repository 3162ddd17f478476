"""The processes that prepare a corpus end with the one that started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

CHILDREN = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
PATIENCE = 1200  # tenths of a second, for a busy machine; a sound one needs a few


def wait_until(true) -> bool:
    for _ in range(PATIENCE):
        if true():
            return True
        time.sleep(0.1)
    return False


def running(process: int) -> bool:
    try:
        return "(zombie)" not in Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(not CHILDREN.is_file(), reason="needs Linux' /proc")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL], ids=lambda s: s.name)
def test_workers_of_prepare_end_with_it(tmp_path, how):
    words = ["prepare", "--format", "synthetic", "--out", "store", "--processes", "2", "--set", "size=3000"]
    process = subprocess.Popen([sys.executable, "-m", "kinema.cli", *words], cwd=tmp_path, stderr=subprocess.DEVNULL)
    try:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        assert wait_until(lambda: len(children.read_text().split()) >= 3)  # two workers, and what tracks resources
        workers = [int(word) for word in children.read_text().split()]
        process.send_signal(how)
        process.wait()
        assert wait_until(lambda: not any(running(worker) for worker in workers))
        assert not (tmp_path / "store").exists()
    finally:
        process.kill()
