"""Names and labels of any kind stand in a report as text, and end nothing."""

from __future__ import annotations

import csv
import io
import re

import pytest

from kinema.report.escape import code, markdown, one_line, spreadsheet, tex
from kinema.report.site import render

HOSTILE = [
    "a\n\\input{/etc/passwd}",
    "a\r\n\\write18{ls}",
    "a\u2028\\input{x}",
    "a\x0b\\input{x}",
    "<script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    "</td><iframe>",
    "<!-- ",
    "[click](javascript:alert(1))",
    "![](http://host/pixel.png)",
    "a | b | c",
    "`code` `",
    '=HYPERLINK("http://host")',
    "=cmd|' /C calc'!A0",
    "+1+cmd",
    "-2+3",
    "@SUM(1)",
    "\t=1+1",
    "\x1b[31mred",
    "%comment $math$ #1 a_b {x} ~ ^",
    "# heading",
    "Grüße <3",
]


@pytest.mark.parametrize("text", HOSTILE)
def test_a_report_shows_hostile_names_as_text(text, tmp_path):
    table = {
        "name": "t",
        "title": text,
        "corpus": text,
        "scale": text,
        "columns": [{"key": "fid", "label": text, "better": "lower", "digits": 2}],
        "rows": [{"key": text, "label": text, "kind": "method", "results": [{"fid": -1.0}], "note": text}],
        "footnotes": [text],
        "provenance": {"corpus": {"name": text}, text: text},
    }
    found = {path.name: path.read_text() for path in render(table, tmp_path)}
    for name in ("table.md", "table.tex", "table.csv"):
        assert not re.search("[\\x00-\\x09\\x0b-\\x1f\\x7f-\\x9f\u2028]", found[name])
    body = re.sub("`[^`\n]*`", "", found["table.md"])
    assert not re.search(r"<[a-zA-Z/!]", body)
    assert not re.search(r"\]\((?!motions)", body)
    rows = [line for line in found["table.md"].splitlines() if line.startswith("|")]
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in rows}) == 1
    for line in found["table.tex"].splitlines():
        assert line.startswith("%") or not re.search(r"\\(input|write)", line)
    cells = [cell for line in csv.reader(io.StringIO(found["table.csv"])) for cell in line]
    assert not [cell for cell in cells if cell.startswith(("=", "+", "@", "-")) and cell != "-1"]


@pytest.mark.parametrize("text", ["MARDM-SiT", "R@1 (top 3)", "a < b", "3 > 2 & 1", "T2M-GPT, τ = 0.5", "AE 67 dims"])
def test_ordinary_names_are_left_as_they_are(text):
    assert one_line(text) == markdown(text) == code(text) == spreadsheet(text) == text
    assert tex(text) == text.replace("&", "\\&")
