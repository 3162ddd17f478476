"""A table's file is checked when it is read, before anything is composed or trained."""

from __future__ import annotations

import pytest

from kinema.experiments import table_files
from kinema.experiments.table_files import load_table

SOUND = """
name: own
title: Own
columns: [{key: fid, label: FID}]
rows: [{key: real, kind: real, label: Real, source: real}]
"""
ROW = "source: real}]"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (ROW, "source: real, override: [seed=1]}]", r"rows real.override is no option; .* has borrow, cannot, key"),
        (ROW, "source: real}, {key: real, kind: method, label: B}]", "two of its rows have the key 'real'"),
        (ROW, "source: real, note: is cut off, by a comma}]", "rows real.by a comma is no option"),
        ("kind: real", "kind: reel", "rows real.kind=reel: must be one of real, control, method"),
        ("title: Own", "titel: Own", "own.yaml.titel is no option"),
        ("title: Own", "", "own.yaml: missing a required argument: 'title'"),
        ("label: FID", "better: up, label: FID", "columns fid.better=up: must be one of higher, lower, real, none"),
        (
            "name: own",
            "name: own\neffects: [{what: x, rows: real, than: real, columns: [fid]}]",
            "effects x.rows is no",
        ),
    ],
)
def test_what_is_wrong_with_a_file_of_a_table_is_told_when_it_is_read(old, new, told, tmp_path, monkeypatch):
    monkeypatch.setattr(table_files, "CONF", tmp_path)
    (tmp_path / "table").mkdir()
    (tmp_path / "table" / "own.yaml").write_text(SOUND)
    assert load_table("own")["paper"] == {}
    assert old in SOUND
    (tmp_path / "table" / "own.yaml").write_text(SOUND.replace(old, new))
    with pytest.raises(ValueError, match=told):
        load_table("own")
