"""Open pages in headless Chromium and speak to it: the DevTools protocol over a pipe, with the standard library."""

from __future__ import annotations

import json
import os
import select
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinema.motion.skeleton import HUMANML3D
from kinema.types import Motion

PATIENCE = 120
"""Seconds after which a page is taken for dead: far beyond what a busy machine needs."""


class Browser:
    """Hold one Chromium and one page of it; messages are JSON, each ended by a zero byte."""

    def __init__(self, binary: str, profile: Path) -> None:
        self.read, theirs_out = os.pipe()
        theirs_in, self.write = os.pipe()

        def wire() -> None:
            os.dup2(theirs_in, 3, inheritable=True)
            os.dup2(theirs_out, 4, inheritable=True)

        options = ("headless=new", "no-sandbox", "disable-gpu", "no-first-run", "mute-audio", "window-size=1200,900")
        options += ("disable-renderer-backgrounding", "disable-backgrounding-occluded-windows")
        options += ("remote-debugging-pipe", f"user-data-dir={profile}")
        self.process = subprocess.Popen(
            [binary, *(f"--{option}" for option in options), "about:blank"],
            preexec_fn=wire,
            pass_fds=(3, 4),
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in), os.close(theirs_out)
        self.rest, self.number, self.session = b"", 0, None
        self.complaints: list[str] = []
        self.asked: list[str] = []
        targets = self.call("Target.getTargets")["targetInfos"]
        target = next(t["targetId"] for t in targets if t["type"] == "page")
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Runtime", "Log", "Page", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send one command and return its result."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.write, json.dumps(message).encode() + b"\0")
        while True:
            found = self.receive()
            if found.get("id") == self.number:
                assert "error" not in found, found["error"]
                return found["result"]

    def receive(self) -> dict[str, Any]:
        """Read one message, and keep what the page complains of."""
        while b"\0" not in self.rest:
            assert select.select([self.read], [], [], PATIENCE)[0], "Chromium doesn't answer"
            self.rest += os.read(self.read, 1 << 20)
        text, _, self.rest = self.rest.partition(b"\0")
        found = json.loads(text)
        method, params = found.get("method"), found.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(params["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning"):
            self.complaints.append(json.dumps(params["args"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
            self.complaints.append(params["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.asked.append(params["request"]["url"])
        return found

    def open(self, path: Path, *, width: int = 1200, dark: bool = False) -> None:
        """Open a page of this disk and wait until it is loaded."""
        self.visit(path.resolve().as_uri(), width=width, dark=dark)

    def visit(self, url: str, *, width: int = 1200, dark: bool = False) -> None:
        """Open what is at an address and wait until it is loaded."""
        self.complaints, self.asked = [], []
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Page.navigate", url=url)
        self.until(f"document.readyState === 'complete' && location.protocol === '{url.partition(':')[0]}:'")

    def js(self, expression: str) -> Any:
        """Return what an expression is worth on the page; promises are awaited."""
        done = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in done, done["exceptionDetails"]
        return done["result"].get("value")

    def until(self, expression: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if self.js(f"Boolean({expression})"):
                return
            time.sleep(0.02)
        raise AssertionError(f"never true: {expression}; the page complained of {self.complaints}")

    def drawn(self) -> None:
        """Wait until the page has drawn what was asked of it before: two frames, for one may be half-way."""
        self.js("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def press(self, key: str) -> None:
        """Press and release a key of the keyboard."""
        code = {"Enter": 13, " ": 32, "Tab": 9, "ArrowRight": 39, "ArrowLeft": 37}[key]
        common = {"key": key, "windowsVirtualKeyCode": code, "code": "Space" if key == " " else key}
        text = {"Enter": "\r", " ": " "}.get(key, "")
        self.call("Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", text=text, **common)
        self.call("Input.dispatchKeyEvent", type="keyUp", **common)

    def close(self) -> None:
        """End the processes of this browser."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        os.close(self.read), os.close(self.write)


@pytest.fixture(scope="session")
def chromium(tmp_path_factory) -> Iterator[Browser]:
    binary = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if binary is None:
        pytest.skip("no Chromium on this machine; it opens the pages")
    found = Browser(binary, tmp_path_factory.mktemp("chromium"))
    yield found
    found.close()


@pytest.fixture
def browser(chromium) -> Iterator[Browser]:
    """Return the browser; a page may complain of nothing and ask no server for anything."""
    yield chromium
    tests = "Multiple readback operations"  # that is a test's own looking at pixels
    assert [text for text in chromium.complaints if tests not in text] == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in chromium.asked), chromium.asked


@pytest.fixture(scope="session")
def walker() -> Motion:
    """Return a figure that glides along Z and sways: 60 frames."""
    body = np.zeros((22, 3))
    for joint, parent in enumerate(HUMANML3D.parents):
        if joint:
            body[joint] = body[parent] + HUMANML3D.rest_directions[joint] * 0.2
    body[:, 1] -= body[:, 1].min()
    t = np.arange(60)[:, None]
    joints = np.repeat(body[None], 60, axis=0)
    joints[:, :, 2] += 0.04 * t
    joints[:, :, 0] += 0.1 * np.sin(t / 5) * body[None, :, 1]
    return Motion(joints.astype(np.float32), np.zeros((60, 0), np.float32), "walk", HUMANML3D.name, HUMANML3D.fps)
