"""What names and files hold is printed as text: no markup, no escape sequence."""

from __future__ import annotations

import pytest

from kinema.runs.console import console, printable


@pytest.mark.parametrize(
    "path",
    ["runs/[a]/b", "[/]", "[red]x[/]", "a[/bold]b", "[link=file:///etc]x", "[[x]]", "a\\[b]", ":smile:", "[@click]"],
)
def test_what_follows_the_first_word_is_no_markup(path):
    with console.capture() as said:
        console.print(f"cached    {path}")
        console.print(f"[yellow]note[/]      {path}")
    assert said.get() == f"cached    {path}\nnote      {path}\n"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[2Jgone", "\\x1b[2Jgone"),
        ("\x1b]0;title\x07", "\\x1b]0;title\\x07"),
        ("\x9b31m", "\\x9b31m"),
        ("a\rb", "a\\rb"),
        ("a\x08b", "a\\x08b"),
        ("a\x00b", "a\\x00b"),
        ("\u202etxt.exe", "\\u202etxt.exe"),
        ("a\tb\nc", "a\tb\nc"),
        ("Grüße, 歩く", "Grüße, 歩く"),
    ],
)
def test_nothing_steers_the_terminal(text, shown):
    assert printable(text) == shown
    with console.capture() as said:
        console.print(f"[red]failed[/]    {text}")
    assert said.get() == f"failed    {shown}\n".expandtabs()
