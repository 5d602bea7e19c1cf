"""`ricochet init` and `ricochet completion`: write a commented strike file or a shell completion script."""

import argparse
import csv
import io
import os

from service.cli.arguments import CommandError, examples
from service.cli.outputs import add_output_file
from service.cli.writers import as_number, require_excel

STRIKE = """\
# A strike, for `ricochet cra` and the other commands. SI units; angles in degrees from the inward normal of the face.
# Lines that begin with "# " and hold a field are optional: remove the "# " to use one, in place of another of its name.

# strength_scatter = "paper_table_1"  # scatter of S in the paper's own tests; by default the scatter of its law

[projectile]
diameter_m = 0.08  # diameter of the shank
length_m = 0.53  # from the nose tip to the base
mass_kg = 13.0
nose = { shape = "ogive", caliber_radius_head = 3.0 }  # radius of the ogive over the diameter, 0.5 or more
# nose = { shape = "conical", length_to_diameter = 1.5 }
# nose = { shape = "spherical", caliber_radius_head = 0.5 }
# nose = { shape = "sphere" }  # the whole body: length_m is diameter_m
# nose = { shape = "flat" }
# nose = { shape = "profile", points = [[0.0, 0.01], [0.06, 0.03], [0.12, 0.04]] }  # x from the tip, radius [m]
# center_of_gravity_m = 0.3  # behind the nose tip; by default of a homogeneous body
# moment_of_inertia_kg_m2 = 0.25  # transverse, about the centre of gravity; by default of a homogeneous body

[target]
compressive_strength_pa = 39e6  # unconfined, of the concrete: 39 MPa
density_kg_m3 = 2250.0
# youngs_modulus_pa = 29.5e9  # by default from the strength by ACI 318-19
# poissons_ratio = 0.5
# thickness_m = 0.5  # of a wall; without it the target is a half-space

[impact]
velocity_m_s = 238.0
# angle_of_attack_deg = 1.0  # axis minus velocity, positive with the nose turned toward the face
# angular_velocity_rad_s = 0.0
# `cra` finds the oblique angle; other commands take it from --angle.

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


TABLE = """\
id,Speed (m/s),fc_MPa,Density (kg/m3),Diameter (mm),Length (mm),Mass (kg),CRH
shot-1,238,39,2250,80,530,13,3
shot-2,300,39,2250,80,530,13,3
shot-3,300,48,2250,80,530,13,3
"""
TABLE_ENDINGS = (".csv", ".xlsx")


def add_init(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet init`."""
    parser.description = (
        "Write a strike file to start from: the strike of the source paper, with every nose shape and strength "
        "law as a comment; or with --table a table of cases for `ricochet batch`. An existing file is not changed."
    )
    parser.epilog = examples("ricochet init", "ricochet init wall.toml", "ricochet init --table cases.csv")
    options = {"nargs": "?", "default": "strike.toml", "help": "default: strike.toml"}
    add_output_file(parser, "file", flag="FILE", endings=(".toml",), **options)
    add_output_file(parser, "--table", endings=TABLE_ENDINGS, help="write a table of cases, .csv or .xlsx, instead")
    parser.set_defaults(run=run_init)


def run_init(args: argparse.Namespace) -> int:
    """Write a strike file or, with `--table`, a table of cases."""
    file, command, content = args.file, "cra", STRIKE.encode()
    if args.table:
        file, command = args.table, "batch"
        content = TABLE.encode()
        if file.ending() == ".xlsx":
            require_excel(f"--table {file}")
            content = as_workbook(TABLE)
    if os.path.lexists(file.path):
        raise CommandError(f"{file}: exists already; name another file")
    file.write(content)
    print(f"wrote {file}; next: ricochet {command} {file}")
    return 0


def as_workbook(table: str) -> bytes:
    """Return a CSV table as an Excel workbook."""
    from openpyxl import Workbook

    book, content = Workbook(write_only=True), io.BytesIO()
    sheet = book.create_sheet("cases")
    for row in csv.reader(table.splitlines()):
        sheet.append([as_number(text) for text in row])
    book.save(content)
    return content.getvalue()


def add_completion(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet completion`."""
    parser.description = (
        "Print a script that lets a shell complete commands, flags, their choices and files. Append it to ~/.bashrc "
        "or ~/.zshrc, or write it to ~/.config/fish/completions/ricochet.fish."
    )
    parser.epilog = examples("ricochet completion bash", "ricochet completion zsh", "ricochet completion fish")
    parser.add_argument("shell", choices=("bash", "zsh", "fish"), help="shell that will run the script")
    parser.set_defaults(run=run_completion)


def run_completion(args: argparse.Namespace) -> int:
    """Print the script of argcomplete, which runs this command for each completion."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["ricochet"], shell=args.shell))
    return 0
