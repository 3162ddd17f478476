"""Test the figure of BAD's masks: it is drawn, and its text version shows what the code does."""

from __future__ import annotations

import sys

import pytest

from kinema.experiments.figures import bad_masks

EXAMPLE = """\
    S  t p0 p1 M3 M2  E  P
S   1  1  1  1  0  0  1  0
t   1  1  1  1  1  1  1  0
p0  1  1  1  1  0  0  1  0
p1  1  1  1  1  0  0  1  0
M3  1  1  1  1  1  0  1  0
M2  1  1  1  1  1  1  1  0
E   1  1  1  1  0  0  1  0
P   1  1  1  1  0  0  1  0
"""


def test_figure_and_text_are_written(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    bad_masks.main(["--out", str(tmp_path / "figure")])
    picture, text = tmp_path / "figure/bad_masks.png", (tmp_path / "figure/bad_masks.txt").read_text()
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert EXAMPLE in text
    assert capsys.readouterr().out.count("wrote") == 2


def test_panels_show_what_training_and_sampling_do():
    (_, training), (_, ours), (_, published) = bad_masks.collect()
    assert len(training) == 4
    assert [int(one.masked.sum()) for one in ours] == [6, 5, 4, 2]
    for one in (*training, *ours):
        decoded = [i for i, label in enumerate(one.labels) if label.startswith("p") and label != "P"]
        assert not (one.visible[decoded] & one.masked).any()
    assert any((a.visible != b.visible).any() for a, b in zip(ours, published, strict=True))
    assert [one.labels for one in ours] == [one.labels for one in published]


def test_without_matplotlib_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    with pytest.raises(SystemExit, match=r"pip install 'kinema\[viz\]'"):
        bad_masks.main(["--out", str(tmp_path)])
