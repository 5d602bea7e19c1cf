"""`ricochet init` and `ricochet completion`: a commented file of a strike, and a script for a shell."""

import argparse
import os
from collections.abc import Iterator

from service.cli.arguments import CommandError, Parser, examples
from service.cli.outputs import add_output_file

STRIKE = """\
# A strike, for `ricochet cra` and the other commands. SI units; angles in degrees from the inward normal of the face.
# Lines that begin with "# " and hold a field are optional: remove the "# " to use one, in place of another of its name.

# strength_scatter = "paper_table_1"  # S as sure as after the paper's tests; as by its law unless given

[projectile]
diameter_m = 0.08  # diameter of the shank
length_m = 0.53  # from the nose tip to the base
mass_kg = 13.0
nose = { shape = "ogive", caliber_radius_head = 3.0 }  # radius of the ogive over the diameter, 0.5 or more
# nose = { shape = "conical", length_to_diameter = 1.5 }
# nose = { shape = "spherical", caliber_radius_head = 0.5 }
# nose = { shape = "sphere" }  # the whole body: length_m is diameter_m
# nose = { shape = "flat" }
# nose = { shape = "profile", points = [[0.0, 0.01], [0.06, 0.03], [0.12, 0.04]] }  # [m] from the tip: x, radius
# center_of_gravity_m = 0.3  # behind the nose tip; that of a homogeneous body unless given
# moment_of_inertia_kg_m2 = 0.25  # transverse, about the centre of gravity; that of a homogeneous body unless given

[target]
compressive_strength_pa = 39e6  # unconfined, of the concrete: 39 MPa
density_kg_m3 = 2250.0
# youngs_modulus_pa = 29.5e9  # from the strength by ACI 318-19 unless given
# poissons_ratio = 0.5
# thickness_m = 0.5  # a wall; a half-space unless given

[impact]
velocity_m_s = 238.0
# angle_of_attack_deg = 1.0  # axis minus velocity, positive with the nose turned toward the face
# angular_velocity_rad_s = 0.0
# The oblique angle is sought by `cra`; other commands take it from --angle.

[resistance]
# strength_factor = { model = "obliquity_polynomial", coefficients = [8.469, 0.0149, -0.0013] }  # eq. 9, the default
# strength_factor = { model = "constant", value = 8.52 }
# strength_factor = { model = "published_tests" }
# strength_factor = { model = "strength_power_law", coefficient = 82.6, exponent = -0.544 }
# free_surface = { model = "elastic_plastic" }  # the default
# free_surface = { model = "mohr_coulomb" }
# free_surface = { model = "none" }
# inertia_factor = 1.0
"""
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


def add_init(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet init`."""
    parser.description = (
        "Write a file of a strike to start from, that of the source paper, with every nose shape and strength law as a "
        "comment. A file that is there already is left as it is."
    )
    parser.epilog = examples("ricochet init", "ricochet init wall.toml")
    options = {"nargs": "?", "default": "strike.toml", "help": "default: strike.toml"}
    add_output_file(parser, "file", flag="FILE", endings=(".toml",), **options)
    parser.set_defaults(run=run_init)


def run_init(args: argparse.Namespace) -> int:
    """Write the file."""
    if os.path.lexists(args.file.path):
        raise CommandError(f"{args.file}: is there already; name another file")
    args.file.write(STRIKE.encode())
    print(f"wrote {args.file}; next: ricochet cra {args.file}")
    return 0


def add_completion(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet completion`."""
    parser.description = (
        "Print a script with which a shell completes commands, flags, their choices and files. Append it to ~/.bashrc "
        "or ~/.zshrc, or write it to ~/.config/fish/completions/ricochet.fish."
    )
    parser.epilog = examples("ricochet completion bash", "ricochet completion zsh", "ricochet completion fish")
    parser.add_argument("shell", choices=("bash", "zsh", "fish"), help="the shell that reads it")
    parser.set_defaults(run=run_completion)


def run_completion(args: argparse.Namespace) -> int:
    """Print the script."""
    from service.cli import COMMANDS, define

    flags, choices = [], []
    fish = ["# Completion of ricochet"]
    for command in COMMANDS:
        parser = Parser(prog=f"ricochet {command.name}")
        define(command, parser)
        fish.append(f"complete -c ricochet -n __fish_use_subcommand -x -a {command.name} -d '{command.help}'")
        fish += _fish(command.name, parser)
        flags.append(f'                {command.name}) words="{" ".join(sorted(set(_words(parser))))}" ;;')
        for names, values in _choices(parser):
            places = "|".join(f'"{command.name} {name}"' for name in names)
            choices.append(f'        {places}) words="{" ".join(values)}" ;;')
    if args.shell == "fish":
        print("\n".join(fish))
        return 0
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


def _fish(command: str, parser: argparse.ArgumentParser) -> Iterator[str]:
    """Yield the lines of fish for the flags of a command, and for the words that stand for themselves."""
    for action in _actions(parser):
        names = [f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}" for name in action.option_strings]
        values = f"-x -a '{' '.join(map(str, action.choices))}'" if action.choices else ""
        if names or values:
            argument = values or ("" if action.nargs == 0 else "-r")
            words = (f"complete -c ricochet -n '__fish_seen_subcommand_from {command}'", *names, argument)
            yield " ".join(filter(None, words))


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
