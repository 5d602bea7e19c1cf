"""Pictures of answers, in files."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.commands.errors import FAILED, CommandError
from service.commands.sinks import Axes, Item, Points
from service.commands.tables import heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Panel
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg", ".pdf")
SNAPSHOTS = 5
MARGIN = 0.08  # of what is shown, around it
SQUARE, WIDE = (6.0, 4.0), (8.0, 4.0)
"""Sizes of a figure. [in]"""
DRAWN = {"cra": "critical_angle_deg", "trajectory": "maximum_depth_m"}
ERROR = "critical_angle_standard_error_deg"
COLORS = {"ricochet": "#c8102e", "embedded": "#123f73", "in_motion": "#8a8378"}


def check_picture(path: Path) -> None:
    """See, before anything is computed, that a picture can be drawn there.

    Raises
    ------
    CommandError
        If it cannot.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise CommandError(f"--plot {path}: must end in {', '.join(SUFFIXES)}")
    if not path.absolute().parent.is_dir():
        raise CommandError(f"--plot {path}: there is no such folder")
    try:
        import_module("matplotlib")
    except ModuleNotFoundError as error:
        text = f"{error.name} is not installed; pictures need it: pip install 'ricochet[reports]'"
        raise CommandError(text, FAILED) from None


def draw_motion(path: Path, body: dict[str, Any], answer: Mapping[str, Any], history: Mapping[str, Any]) -> None:
    """Draw the projectile from the side, at instants of its motion."""
    import numpy as np

    from service.reports.side_view import draw_concrete, draw_path, silhouette, tip_path
    from service.schemas.projectile import Projectile

    projectile = Projectile.model_validate(body["projectile"]).to_solver()
    depth = np.array(history["center_of_gravity_depth_m"])
    tip = tip_path(
        projectile,
        time=np.array(history["time_s"]),
        depth_displacement=depth - depth[0],
        lateral_displacement=np.array(history["center_of_gravity_lateral_m"]),
        axis_angle=np.radians(history["axis_angle_deg"]),
    )
    length, breadth = silhouette(projectile).max(axis=0)
    margin = MARGIN * length + breadth
    lateral = np.concatenate((tip.lateral, tip.lateral - length * np.sin(tip.axis_angle)))
    down = np.concatenate((tip.depth, tip.depth - length * np.cos(tip.axis_angle), [0.0]))
    with picture(path, WIDE) as (_, panel):
        draw_path(panel, projectile, tip, np.linspace(0.0, tip.time[-1], SNAPSHOTS))
        draw_concrete(
            panel,
            lateral=(lateral.min() - margin, lateral.max() + margin),
            depth=(down.min() - margin, down.max() + margin),
        )
        panel.set(xlabel="along the face [m]", ylabel="depth [m]", title=answer["outcome"].replace("_", " "))
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_search(path: Path, answer: Mapping[str, Any]) -> None:
    """Draw where each trial ended over its angle, and the critical angle."""
    with picture(path, SQUARE) as (_, panel):
        for outcome, color in COLORS.items():
            trials = [trial for trial in answer["iterations"] if trial["outcome"] == outcome]
            if trials:
                angles = [trial["oblique_angle_deg"] for trial in trials]
                ends = [trial["final_position_m"] for trial in trials]
                panel.plot(angles, ends, "o", color=color, label=outcome.replace("_", " "))
        if "critical_angle_deg" in answer:
            angle = answer["critical_angle_deg"]
            panel.axvline(angle, color="#5c6670", linestyle="--", label=f"critical angle {angle:.2f}°")
        panel.set(xlabel="oblique angle from the normal [°]", ylabel="nose tip at the end, depth [m]")
        panel.legend()


class Map:
    """The results of a sweep over one axis as a line, over two as a map. A sink.

    Parameters
    ----------
    path
        Of the picture.
    """

    def __init__(self, path: Path, operation: str, axes: Axes) -> None:
        self._path = path
        self._name = DRAWN[operation]
        self._axes = axes
        self._points = Points(axes)
        self._found: dict[int, Mapping[str, Any]] = {}

    def write(self, items: Sequence[Item]) -> None:
        """Keep what is drawn."""
        for item in items:
            answer = item.get("result", {})
            self._found[item["index"]] = {name: answer[name] for name in (self._name, ERROR) if name in answer}

    def end(self) -> None:
        """Draw it; what has no value is left out."""
        labels = [labelled(name) for name in self._axes]
        with picture(self._path, SQUARE) as (figure, panel):
            if len(labels) == 1:
                self._draw_line(panel)
                panel.set(xlabel=labels[0], ylabel=labelled(self._name))
            else:
                self._draw_map(figure, panel)
                panel.set(xlabel=labels[0], ylabel=labels[1])

    def _draw_line(self, panel: "Panel") -> None:
        points = sorted((self._points.at(i)[0], found) for i, found in self._found.items() if self._name in found)
        values = [found[self._name] for _, found in points]
        errors = [found.get(ERROR, 0.0) for _, found in points]
        bars = errors if any(errors) else None
        panel.errorbar([x for x, _ in points], values, bars, fmt="o-", capsize=3.0)

    def _draw_map(self, figure: "Figure", panel: "Panel") -> None:
        import numpy as np

        first, second = (sorted(set(values)) for values in self._axes.values())
        shown = np.full((len(second), len(first)), np.nan)
        for index, found in self._found.items():
            x, y = self._points.at(index)
            shown[second.index(y), first.index(x)] = found.get(self._name, np.nan)
        mesh = panel.pcolormesh(first, second, np.ma.masked_invalid(shown), shading="nearest", cmap="viridis")
        panel.grid(visible=False)
        figure.colorbar(mesh, ax=panel, label=labelled(self._name))


def labelled(name: str) -> str:
    """Return a name of the contract with its unit in brackets."""
    words, _, unit = heading(name).rpartition(" ")
    return f"{words} [{unit}]" if heading(name) != name and words else heading(name)


@contextmanager
def picture(path: Path, size: tuple[float, float]) -> "Iterator[tuple[Figure, Panel]]":
    """Give a figure with one panel, to be drawn on; then write it.

    Raises
    ------
    CommandError
        If it cannot be written.
    """
    from matplotlib.figure import Figure

    from service.reports.style import styled

    with styled():
        figure = Figure(figsize=size, layout="constrained")
        yield figure, figure.subplots()
        try:
            figure.savefig(path)
        except OSError as error:
            raise CommandError(f"--plot {path}: {error.strerror or error}", FAILED) from None
