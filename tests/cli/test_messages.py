"""Messages for invalid inputs match the text in `messages.txt`. The commands run in one process, without a service.

The first line of a message names the flag, the file or the cell, and the value. After a change of words,
`.venv/bin/python -m tests.cli.test_messages` writes the file; read the differences before you commit them.
"""

import re
import shlex
import tempfile
from pathlib import Path

from service import cli
from tests.cli.commands import STRIKE_TOML, run

MESSAGES = Path(__file__).with_name("messages.txt")
FILES = {
    "strike.toml": STRIKE_TOML,
    "empty.toml": "",
    "half.toml": STRIKE_TOML.replace("mass_kg = 13.0", ""),
    "cube.toml": STRIKE_TOML.replace("ogive", "cube"),
    "typo.toml": STRIKE_TOML.replace("diameter_m", "diametre_m"),
    "words.toml": STRIKE_TOML.replace("13.0", '"heavy"').replace("238.0", "true"),
    "list.json": "[]",
    "broken.json": '{"projectile": ',
    "units.csv": "Speed (furlong),fc_MPa,Nose (CRH)\n238,39,3\n",
    "gaps.csv": "CRH,Diameter (mm),Length (mm),Mass (kg),fc_MPa,density,Speed (m/s)\n"
    "3,80,530,,39,2250,238\n3,0.08,530,13,39,2250,238\n",
    "columns.csv": "velocty,colour,mass,weight\n238,red,13,13\n",
    "rows.csv": 'id,Speed (m/s),Length (mm)\na,-238,530\nb,fast,50\nc,"238,5",530\n',
    "bare.csv": "Speed (m/s)\n238\n",
    "shots.csv": "velocity [kn],depth\n238,0.3\n",
    "points.csv": "oblique_angle_deg,strength_factor\n0,8.5\n",
}
COMMANDS = """\
--nose ogive
crra strike.toml
jobs lst
calibrate dept tests.csv
cra --speed 300
cra --strength 39e6
cra --crh 3
cra --velocty 300
cra --velocity
cra --velocity fast
cra --angle 45 --angle x
cra --nose cube
cra --strength-law power
cra --profile 0,1,2
cra --strength-coefficients 8;1
cra --json --csv
cra --digits 0 --csv
cra strike.toml again.toml
trajectory strike.toml
trajectory strike.toml --angle 95
trajectory strike.toml --angle 45 --plot a.gif
trajectory strike.toml --angle 45 -o a.xlsx
trajectory strike.toml --angle 45 -o missing/a.csv
trajectory strike.toml --angle 45 -o strike.toml --json
cra
cra missing.toml
cra empty.toml
cra half.toml
cra cube.toml
cra typo.toml
cra words.toml
cra list.json
cra broken.json
cra strike.toml --velocity -3
cra strike.toml --velocity nan
cra strike.toml --diameter 80
cra strike.toml --compressive-strength 39
cra strike.toml --length 0.05
cra strike.toml --nose flat --caliber-radius-head 3
cra strike.toml --set impact
cra strike.toml --set target.strength=3
cra strike.toml --set impact.speed=3
cra strike.toml --set projectile.calibre=3
cra strike.toml --set search.width=3
cra strike.toml --set impact.velocity_m_s=fast
cra strike.toml --set search.method=newton
cra strike.toml --set target=concrete
cra strike.toml --shots shots.csv
cra strike.toml --shots missing.csv
uncertainty strike.toml --uncertain velocity=normal:238:2
uncertainty strike.toml --uncertain target.strength=normal:39e6:1e6
uncertainty strike.toml --uncertain impact.velocity_m_s=gauss:238:2
uncertainty strike.toml --uncertain impact.velocity_m_s=normal:238
uncertainty strike.toml --uncertain impact.velocity_m_s=normal:238:-2
uncertainty strike.toml --uncertain impact.velocity_m_s=normal:fast:2
sweep strike.toml
sweep strike.toml --axis impact.velocity_m_s
sweep strike.toml --axis impact.speed=200,300
sweep strike.toml --axis impact.velocity_m_s=200,-3
limit-speed strike.toml --angle 20
flight --speed 100
batch units.csv --case strike.toml
batch columns.csv --case strike.toml
batch rows.csv --case strike.toml
batch gaps.csv
batch bare.csv
batch strike.toml --keep remark
batch missing.csv
batch bare.csv --case words.toml
calibrate obliquity points.csv --order x
calibrate obliquity missing.csv
keys add --owner a --cases-per-hour many
serve --port http
cache evict --bytes much
"""
INTERNAL = re.compile(
    r"Input should|Extra inputs|Field required|pydantic|instance of|Traceback|\w+(Base|Request|Model|Error)\b|usage:"
)
"""Words of the implementation that no message may contain."""


def messages(folder: Path) -> str:
    """Return every command, followed by its output on standard error, as in `messages.txt`."""
    for name, text in FILES.items():
        (folder / name).write_text(text)
    found = []
    for line in COMMANDS.splitlines():
        done = run(folder, *shlex.split(line.replace(";", "\\;")))
        assert (done.status, done.out) in {(1, ""), (2, ""), (3, "")}, line
        found.append(f"$ ricochet {line}\n{done.err}")
    return "\n".join(found)


def test_messages_match_the_reviewed_file(tmp_path: Path) -> None:
    assert messages(tmp_path) == MESSAGES.read_text(encoding="utf-8")


def test_messages_begin_with_the_command_and_have_no_internal_names() -> None:
    text = MESSAGES.read_text(encoding="utf-8")
    blocks = text.split("\n\n")
    assert len(blocks) >= 60
    for block in blocks:
        command, first, *_ = block.splitlines()
        name = next((word for word in command.split()[2:3] if word in {each.name for each in cli.COMMANDS}), "")
        assert first.startswith(f"ricochet {name}".strip()), command
        assert not INTERNAL.search(block.removeprefix(command)), command


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        MESSAGES.write_text(messages(Path(place)), encoding="utf-8")
