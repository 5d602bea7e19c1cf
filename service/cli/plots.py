"""Plots of answers, written to files."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from io import BytesIO
from typing import TYPE_CHECKING, Any

from service.cli.arguments import FAILED, CommandError
from service.cli.outputs import OutputFile
from service.cli.writers import Item, Writer, heading
from service.columns import summarize

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Panel
    from matplotlib.figure import Figure

SNAPSHOTS = 5
"""Number of outlines of the projectile in a plot of a motion; more would overlap."""
MARGIN = 0.08
"""Margin around the projectile, relative to its length: enough for lines and dots at its edge. [1]"""
SQUARE, WIDE = (6.0, 4.0), (8.0, 4.0)
"""Sizes of figures without and with a legend beside the panel [in]."""
PLOTTED = {
    "cra": "critical_angle_deg",
    "trajectory": "maximum_depth_m",
    "thickness": "least_thickness_m",
    "limit-speed": "limit_speed_m_s",
    "cra_uncertainty": "mean_deg",
    "trajectory_uncertainty": "ricochet",
}
"""Column that a plot of a sweep shows, by operation."""
ERROR = "critical_angle_standard_error_deg"
COLORS = {"ricochet": "#c8102e", "embedded": "#123f73", "in_motion": "#8a8378", "perforated": "#2e7d32"}


def check_plot() -> None:
    """Check before the computation that plots can be drawn.

    Raises
    ------
    CommandError
        If matplotlib is not installed, or cannot read its settings in the working folder.
    """
    try:
        # The import itself reads a matplotlibrc in the working folder, and fails if that file is damaged.
        import_module("matplotlib")
    except UnicodeDecodeError:
        raise CommandError("matplotlibrc: the file of matplotlib in this folder is not UTF-8", FAILED) from None
    except ModuleNotFoundError as error:
        from service.settings import missing_package

        raise CommandError(missing_package("--plot", str(error.name), "reports"), FAILED) from None


def plot_motion(
    output: OutputFile, body: dict[str, Any], answer: Mapping[str, Any], history: Mapping[str, Any]
) -> None:
    """Plot the projectile from the side at several instants."""
    import numpy as np

    from service.reports.style import draw_concrete, draw_path, silhouette, tip_path
    from service.schemas.strike import Projectile

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
    with figure_file(output, WIDE) as (_, panel):
        draw_path(panel, projectile, tip, np.linspace(0.0, tip.time[-1], SNAPSHOTS))
        draw_concrete(
            panel,
            lateral=(lateral.min() - margin, lateral.max() + margin),
            depth=(down.min() - margin, down.max() + margin),
        )
        panel.set(xlabel="along the face [m]", ylabel="depth [m]", title=answer["outcome"].replace("_", " "))
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def plot_search(output: OutputFile, answer: Mapping[str, Any]) -> None:
    """Plot the final position of each trial against the oblique angle, and mark the critical angle."""
    with figure_file(output, SQUARE) as (_, panel):
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


class SweepPlot(Writer):
    """Writer that plots the results of a sweep, as a line over one axis or as a map over two.

    Parameters
    ----------
    output
        File of the plot.
    fields
        Fields of the axes.
    """

    def __init__(self, output: OutputFile, operation: str, fields: Sequence[str]) -> None:
        self._output = output
        self._name = PLOTTED[operation]
        self._fields = fields
        self._values: dict[tuple[float, ...], Mapping[str, float]] = {}

    def write(self, items: Sequence[Item]) -> None:
        """Collect the values to plot."""
        for item in items:
            answer = summarize(item["result"]) if "result" in item else {}
            point = tuple(item["point"][field] for field in self._fields)
            self._values[point] = {name: answer[name] for name in (self._name, ERROR) if name in answer}

    def close(self) -> None:
        """Write the plot. Cases without a value are left out."""
        if not self._values:
            return
        labels = [labelled(field) for field in self._fields]
        with figure_file(self._output, SQUARE) as (figure, panel):
            if len(labels) == 1:
                self._draw_line(panel)
                panel.set(xlabel=labels[0], ylabel=labelled(self._name))
            else:
                self._draw_map(figure, panel)
                panel.set(xlabel=labels[0], ylabel=labels[1])

    def _draw_line(self, panel: "Panel") -> None:
        # The values of an axis may be given in any order, but the line must connect them in ascending order.
        points = sorted(point for point, values in self._values.items() if self._name in values)
        heights = [self._values[point][self._name] for point in points]
        errors = [self._values[point].get(ERROR, 0.0) for point in points]
        panel.errorbar([x for (x,) in points], heights, errors if any(errors) else None, fmt="o-", capsize=3.0)

    def _draw_map(self, figure: "Figure", panel: "Panel") -> None:
        import numpy as np

        first, second = (sorted(set(values)) for values in zip(*self._values, strict=True))
        shown = np.full((len(second), len(first)), np.nan)
        for (x, y), values in self._values.items():
            shown[second.index(y), first.index(x)] = values.get(self._name, np.nan)
        mesh = panel.pcolormesh(first, second, np.ma.masked_invalid(shown), shading="nearest", cmap="viridis")
        panel.grid(visible=False)
        figure.colorbar(mesh, ax=panel, label=labelled(self._name))


def labelled(name: str) -> str:
    """Return the name of a field with its unit in brackets."""
    words, _, unit = heading(name).rpartition(" ")
    return f"{words} [{unit}]" if heading(name) != name and words else heading(name)


@contextmanager
def figure_file(output: OutputFile, size: tuple[float, float]) -> "Iterator[tuple[Figure, Panel]]":
    """Open a figure with one panel, and write it to a file at the end of the block.

    Raises
    ------
    CommandError
        If the file cannot be written.
    """
    from matplotlib.figure import Figure

    from service.reports.style import styled

    with styled():
        figure, picture = Figure(figsize=size, layout="constrained"), BytesIO()
        yield figure, figure.subplots()
        figure.savefig(picture, format=output.ending()[1:])
    output.write(picture.getvalue())
