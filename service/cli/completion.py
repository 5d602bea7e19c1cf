"""`ricochet completion`: a script with which a shell completes commands, actions, flags and their choices."""

import argparse
from collections.abc import Iterator

from service.cli.arguments import examples

BASH = """\
# Completion of ricochet
_ricochet() {
    local words="" before="${COMP_WORDS[COMP_CWORD-1]}" current="${COMP_WORDS[COMP_CWORD]}"
    case "${COMP_WORDS[1]-} $before" in
%(choices)s
        *)
            if [ "$COMP_CWORD" -eq 1 ]; then words="%(commands)s --help --version"
            else case "${COMP_WORDS[1]-}" in
%(flags)s
            esac; fi ;;
    esac
    COMPREPLY=($(compgen -W "$words" -- "$current"))
    if [ "${#COMPREPLY[@]}" -eq 0 ]; then COMPREPLY=($(compgen -f -- "$current")); fi
}
complete -o filenames -F _ricochet ricochet
"""
ZSH = "autoload -Uz compinit bashcompinit && compinit && bashcompinit\n"


def add_completion(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet completion`."""
    parser.description = (
        "Print a script with which a shell completes commands, flags, their choices and files. Append it to ~/.bashrc "
        "or ~/.zshrc."
    )
    parser.epilog = examples("ricochet completion bash", "ricochet completion zsh")
    parser.add_argument("shell", choices=("bash", "zsh"), help="the shell that reads it")
    parser.set_defaults(run=run_completion)


def run_completion(args: argparse.Namespace) -> int:
    """Print the script."""
    from service.cli import COMMANDS, define

    flags, choices = [], []
    for command in COMMANDS:
        parser = argparse.ArgumentParser(prog=f"ricochet {command.name}")
        define(command, parser)
        flags.append(f'                {command.name}) words="{" ".join(sorted(set(_words(parser))))}" ;;')
        for names, values in _choices(parser):
            places = "|".join(f'"{command.name} {name}"' for name in names)
            choices.append(f'        {places}) words="{" ".join(values)}" ;;')
    script = BASH % {
        "commands": " ".join(command.name for command in COMMANDS),
        "flags": "\n".join(flags),
        "choices": "\n".join(choices),
    }
    print((ZSH if args.shell == "zsh" else "") + script, end="")
    return 0


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield what a parser takes, and what those of its actions take."""
    for action in parser._actions:  # noqa: SLF001 (argparse has no other list)
        yield action
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for subparser in action.choices.values():
                yield from _actions(subparser)


def _words(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Yield flags, and the words that stand for themselves."""
    for action in _actions(parser):
        yield from action.option_strings
        if not action.option_strings and action.choices:
            yield from map(str, action.choices)


def _choices(parser: argparse.ArgumentParser) -> Iterator[tuple[list[str], list[str]]]:
    """Yield the names of every flag that has choices, and these."""
    for action in _actions(parser):
        if action.option_strings and action.choices:
            yield list(action.option_strings), list(map(str, action.choices))
