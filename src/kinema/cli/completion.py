"""Write a shell script that completes `kinema`, from the parser itself."""

from __future__ import annotations

import argparse

from kinema.cli.parser import command_line
from kinema.experiments.config import CONF

BASH = """# eval "$(kinema completion bash)", or keep it where your shell looks for completions
_kinema() {{
  local command="${{COMP_WORDS[1]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" word="${{COMP_WORDS[COMP_CWORD]}}" words=""
  if [ "$COMP_CWORD" -eq 1 ]; then
    words="{commands}"
  else
    case "$command $before" in
{choices}
    esac
    [ -n "$words" ] || case "$command" in
{options}
    esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o default -F _kinema kinema
"""
ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"


def completion(options: argparse.Namespace) -> None:
    """Print the script for a shell; zsh reads bash's."""
    print((ZSH if options.shell == "zsh" else "") + script(), end="")


def script() -> str:
    """Return the script of bash: commands, then their options and the choices that those have."""
    (commands,) = (a for a in command_line()._actions if isinstance(a, argparse._SubParsersAction))
    tables = sorted(file.stem for group in ("table", "page") for file in (CONF / group).glob("*.yaml"))
    choices, options = [f'      "reproduce reproduce") words="{" ".join(tables)}" ;;'], []
    for name, parser in commands.choices.items():
        words = [word for action in parser._actions for word in action.option_strings]
        for action in parser._actions:
            if action.choices is None:
                continue
            allowed = " ".join(map(str, action.choices))
            if action.option_strings:
                choices += [f'      "{name} {word}") words="{allowed}" ;;' for word in action.option_strings]
            else:
                choices.append(f'      "{name} {name}") words="{allowed}" ;;')
        options.append(f'      {name}) words="{" ".join(words)}" ;;')
    return BASH.format(commands=" ".join(commands.choices), choices="\n".join(choices), options="\n".join(options))
