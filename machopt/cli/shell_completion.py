"""The command ``completion``: completion scripts for shells."""

from __future__ import annotations

import argparse
from typing import Any

from machopt.cli.argument_errors import list_commands, list_options

Commands = Any  # argparse keeps its subparsers' type private

_BASH = """\
_machopt() {{
  local cur="${{COMP_WORDS[COMP_CWORD]}}" command="${{COMP_WORDS[1]}}" words=""
  if [ "$COMP_CWORD" -eq 1 ]; then
    words="{commands} --help --version"
  else
    case "$command ${{COMP_WORDS[COMP_CWORD-1]}}" in
{values}
    esac
    case "$command/$cur" in
{options}
    esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$cur"))
}}
complete -o default -o bashdefault -F _machopt machopt
"""
_ZSH = """\
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit; }
autoload -U +X bashcompinit && bashcompinit
"""  # the completion of bash rests on zsh's own, which a bare .zshrc does not start


def add_commands(commands: Commands, whole: argparse.ArgumentParser) -> None:
    """Add the command to the parser.

    Args:
        commands: The sub-parsers of the main parser.
        whole: The main parser with all commands.
    """
    p = commands.add_parser(
        "completion", help='print the completion script of a shell: eval "$(machopt completion bash)"'
    )
    p.add_argument("shell", choices=("bash", "zsh", "fish"))
    p.set_defaults(run=lambda args: _print_completion(args.shell, whole), debug=False)


def _print_completion(shell: str, whole: argparse.ArgumentParser) -> int:
    print(build_completion_script(shell, list_commands(whole)), end="")
    return 0


def build_completion_script(shell: str, parsers: dict[str, argparse.ArgumentParser]) -> str:
    """Return the script of a shell: commands, options, and the words that an option accepts; else files.

    Args:
        shell: Bash, zsh or fish.
        parsers: Parser of each command by name.
    """
    values = {name: _list_option_values(parser) for name, parser in parsers.items()}
    if shell == "fish":
        return "".join(_format_fish_lines(name, parser, values[name]) for name, parser in parsers.items())
    cases = [
        f'      "{name} {word}") words="{" ".join(words)}" ;;'
        for name, of in values.items()
        for word, words in of.items()
    ]
    options = [f'      {name}/-*) words="{" ".join(list_options(parser))}" ;;' for name, parser in parsers.items()]
    text = _BASH.format(commands=" ".join(parsers), values="\n".join(cases), options="\n".join(options))
    return text if shell == "bash" else _ZSH + text


def _list_option_values(parser: argparse.ArgumentParser) -> dict[str, list[str]]:
    """What may follow an option, where that is one of few words; after the command itself, where its first word is."""
    from machopt.programs.program_writer import list_post_names

    out: dict[str, list[str]] = {}
    for action in (a for a in parser._actions if a.help != argparse.SUPPRESS):
        words = [str(c) for c in action.choices or ()]
        if "--post" in action.option_strings:
            words = list(list_post_names())  # a template's file will do, too: no choices for argparse
        for word in action.option_strings if words else ():
            out[word] = words
        if words and not action.option_strings:
            out[parser.prog.split()[-1]] = words
    return out


def _format_fish_lines(name: str, parser: argparse.ArgumentParser, values: dict[str, list[str]]) -> str:
    begin = f"complete -c machopt -n '__fish_seen_subcommand_from {name}'"
    lines = [f"complete -c machopt -n __fish_use_subcommand -f -a {name}"]
    lines += [f"{begin} -f -a '{' '.join(values[name])}'"] if name in values else []
    for action in (a for a in parser._actions if a.help != argparse.SUPPRESS):
        takes = "" if action.nargs == 0 else " -r"
        for word in (w for w in action.option_strings if w.startswith("--")):
            few = f" -x -a '{' '.join(values[word])}'" if word in values else takes
            lines.append(f"{begin} -l {word.removeprefix('--')}{few}")
    return "\n".join(lines) + "\n"
