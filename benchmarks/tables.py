"""results.md: the figures of results.json for a reader."""

from collections.abc import Iterable
from typing import Any

KINDS = {"threads": ("thread", "threads"), "processes": ("process", "processes")}


def as_markdown(results: dict[str, Any]) -> str:
    """The whole page."""
    parts = [
        "# Measured\n",
        *_circumstances(results["parts"]),
        "Medians, in brackets the lowest and highest of the repetitions. Ratios are to the NumPy script in the same",
        "repetition. CPU time is that of the process that does the work, with all its threads. By `make bench`.\n",
        "## Critical angle of the paper's strike\n",
        _angles(results),
        "## One trajectory, 45°, until the projectile stops\n",
        _trajectories(results),
        "## Two workers over one\n",
        _scaling(results["scaling"]),
        "## Many random strikes\n",
        _throughput(results),
        "## A fresh process\n",
        _startup(results["startup"]),
    ]
    return "\n".join(parts)


def _circumstances(parts: dict[str, Any]) -> list[str]:
    """On what the parts were measured, and when; those of one day on one machine in one paragraph."""
    told: dict[tuple[str, ...], list[str]] = {}
    for name, part in parts.items():
        machine = part["machine"]
        lines = (
            f"{machine['processor']}, {machine['cores']} cores, {machine['memory_gb']} GB; {machine['os']}.",
            ", ".join(f"{library} {number}" for library, number in part["versions"].items()) + ".",
            part["measured_at"][:10],
        )
        told.setdefault(lines, []).append(name.replace("_", " "))
    return [f"{lines[0]}\n{lines[1]}\n{lines[2]}: {', '.join(names)}.\n" for lines, names in told.items()]


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table with an empty line after it."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def time_text(found: dict[str, Any]) -> str:
    """Median and extremes of times. [s]"""
    median = found["median"]
    unit, scale = ("s", 1.0) if median >= 1.0 else ("ms", 1e3) if median >= 1e-3 else ("µs", 1e6)
    low, middle, high = (f"{found[name] * scale:.3g}" for name in ("lowest", "median", "highest"))
    return f"{middle} {unit} ({low}-{high})"


def number_text(found: dict[str, Any]) -> str:
    """Median and extremes of pure numbers."""
    low, middle, high = (_digits(found[name]) for name in ("lowest", "median", "highest"))
    return f"{middle} ({low}-{high})"


def _digits(value: float) -> str:
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def _angles(results: dict[str, Any]) -> str:
    references = results["references"]
    head = ["", "CPU time", "wall time", "CPU ratio", "angle", "error", "error of own criterion", "trajectories"]
    rows = [
        [
            row["label"],
            time_text(row["cpu_s"]),
            time_text(row["wall_s"]),
            number_text(row["cpu_ratio"]),
            f"{row['angle_deg']:.3f}°",
            f"{row['error_deg']:.3f}°",
            f"{row['error_of_own_criterion_deg']:.3f}°",
            str(row["trajectories"]),
        ]
        for row in results["angles"].values()
    ]
    system = results["angles"]["numpy_script"]["system_s"]
    return (
        table(head, rows)
        + f"\nErrors are against the converged angle by outcome, {references['by_outcome_deg']:.4f}°. The secant\n"
        "searches seek the paper's, at which the tip is back at the face after 5 ms: "
        f"{references['by_tip_at_5_ms_deg']:.4f}°.\n"
        f"Of the script's CPU time {time_text(system)} were the operating system's.\n"
    )


def _trajectories(results: dict[str, Any]) -> str:
    times = next(iter(results["trajectories"].values()))["times_s"]
    head = ["", "CPU time", "wall time", "CPU ratio", *(f"tip error at {time * 1e3:g} ms" for time in times)]
    rows = [
        [
            row["label"],
            time_text(row["cpu_s"]),
            time_text(row["wall_s"]),
            number_text(row["cpu_ratio"]),
            *(f"{error * 1e3:.3f} mm" for error in row["error_m"]),
        ]
        for row in results["trajectories"].values()
    ]
    return table(head, rows) + "\nThe script cannot tell that the projectile has stopped and runs its 5 ms.\n"


def _throughput(results: dict[str, Any]) -> str:
    head = ["cases", "by", "wall time a case", "CPU time a case", "cases per second", "times one worker", "failures"]
    rows = [
        [
            f"{row['cases']:,}",
            f"{row['workers']} {KINDS[row['kind']][row['workers'] > 1]}",
            time_text(row["wall_s_per_case"]),
            time_text(row["cpu_s_per_case"]),
            number_text(row["cases_per_second"]),
            number_text(row["times_one_worker"]) if "times_one_worker" in row else "",
            str(row["failures"]),
        ]
        for row in results["throughput"] + results.get("long_batches", [])
    ]
    return table(head, rows)


def _scaling(found: dict[str, Any]) -> str:
    strikes = f"{found['strikes']} random strikes"
    works = {
        "threads": f"{strikes}, threads",
        "processes": f"{strikes}, processes that share nothing",
        "multiply_adds": "multiply-adds in the first-level cache, threads",
        "registers": "a short loop in registers, threads",
    }
    rows = [
        [label, *(number_text(found[work][column]) for column in ("times_one", "cpu_ratio", "busy"))]
        for work, label in works.items()
    ]
    return table(["", "wall time of one over that of two", "CPU time of two over that of one", "cores busy"], rows)


def _startup(found: dict[str, Any]) -> str:
    rows = [
        ["import of the solver", time_text(found["import_s"])],
        ["first critical angle", time_text(found["answer_s"])],
        ["whole process, interpreter included", time_text(found["process_s"])],
        ["resident memory after it", f"{number_text(found['resident_mb'])} MB"],
    ]
    if "compiling_s" in found:
        rows.append(["whole process when all must be compiled first", f"{found['compiling_s']:.1f} s"])
    return table(["", ""], rows)
