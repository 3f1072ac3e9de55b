"""The command ``completion``: what a shell needs to complete commands and options."""

from __future__ import annotations

import argparse
from typing import Any

from machopt.cli.parser import commands_of, options_of

Commands = Any  # argparse keeps its subparsers' type private

_BASH = """\
_machopt() {{
  local words=""
  case "${{COMP_WORDS[1]}}" in
{cases}
  esac
  [ "$COMP_CWORD" -eq 1 ] && words="{commands} --help --version"
  COMPREPLY=($(compgen -W "$words" -- "${{COMP_WORDS[COMP_CWORD]}}"))
}}
complete -o default -o bashdefault -F _machopt machopt
"""


def add_commands(commands: Commands, whole: argparse.ArgumentParser) -> None:
    """Add the command to the parser; ``whole`` is the one that has all of them."""
    p = commands.add_parser("completion", help='completion for a shell: eval "$(machopt completion bash)"')
    p.add_argument("shell", choices=("bash", "zsh", "fish"))
    p.set_defaults(run=lambda args: _completion(args.shell, whole), debug=False)


def _completion(shell: str, whole: argparse.ArgumentParser) -> int:
    print(script(shell, commands_of(whole)), end="")
    return 0


def script(shell: str, parsers: dict[str, argparse.ArgumentParser]) -> str:
    """What the shell reads."""
    options = {name: options_of(parser) for name, parser in parsers.items()}
    if shell == "fish":
        seen = "complete -c machopt -n __fish_use_subcommand -f -a '{}'\n"
        each = "complete -c machopt -n '__fish_seen_subcommand_from {}' -l {}\n"
        lines = [seen.format(" ".join(options))]
        return "".join(lines + [each.format(c, o.removeprefix("--")) for c, words in options.items() for o in words])
    cases = "\n".join(f'    {name}) words="{" ".join(words)}" ;;' for name, words in options.items())
    head = "autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    return head + _BASH.format(cases=cases, commands=" ".join(options))
