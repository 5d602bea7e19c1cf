"""Table 2, eq. 9 and Figure 12: the strength factor over the oblique angle."""

import math

import numpy as np
from matplotlib.axes import Axes

from service.reports import style
from service.reports.contents import Comparison, Figure, Section, Table, Tell, paragraphs, stack
from service.reports.paper.strike import finite_element_depths, finite_element_fit
from service.reports.reference import equation_9, paper_value, table_2
from solver.arrays import FloatArray
from solver.calibration import Estimate, ObliquityFit, ObliquityPoint, fit_obliquity

OBLIQUE_RUNS = {15.0: "oblique-15", 30.0: "oblique-30", 45.0: "oblique-45"}
"""By angle. [°]"""
HALF_DIGITS = (0.0005, 0.00005, 0.00005)
"""Half of the last printed digit of each coefficient of eq. 9. [1, 1/°, 1/°²]"""
UNITS = ("1", "1/°", "1/°²")
ANGLES = np.linspace(0.0, 60.0, 121)
"""[°]"""


def section(tell: Tell) -> Section:
    """Return Table 2, eq. 9 and Figure 12."""
    tell("strength factor over the oblique angle")
    fitted = fit_table_2()
    printed = dict(table_2())
    own = {0.0: finite_element_depths().estimate}
    own |= {degrees: finite_element_fit(name).estimate for degrees, name in OBLIQUE_RUNS.items()}
    critical = paper_value("critical_ricochet_angle_deg")
    extrapolated = float(_polynomial(fitted, np.array([critical]))[0])
    rises = fitted.coefficients[1] / (-2.0 * fitted.coefficients[2])
    return Section(
        title="Table 2, eq. 9 and Figure 12: S over the oblique angle",
        text=paragraphs(
            f"""
            Eq. 9 is the least-squares polynomial of second order through the four points of Table 2. The
            same fit gives the printed coefficients to their last digit.

            It has one degree of freedom left, rises up to {rises:.0f}° and is used beyond its last point:
            at the critical angle of {critical:g}° it gives S = {extrapolated:.2f}. The steep end hangs on
            the one point at 45°.

            Beside it are the S of our own finite element runs, from four depths at 0° as in the paper and
            fitted as in Figures 9 to 11 elsewhere. From 0° to 45° they fall by
            {fall(own[0.0].strength_factor, own[45.0].strength_factor):.0f} %, those of Table 2 by
            {fall(printed[0.0], printed[45.0]):.0f} %: the decline towards oblique strikes is there in both. The
            intervals are wide, since one S cannot follow both the depth and the rotation of these runs.
            """
        ),
        comparisons=_comparisons(fitted),
        tables=[_table(fitted, own)],
        figures=[_figure(fitted, own)],
    )


def fall(first: float, last: float) -> float:
    """How much lower the last is. [%]"""
    return 100.0 * (1.0 - last / first)


def fit_table_2() -> ObliquityFit:
    """Fit the polynomial of eq. 9 to Table 2."""
    return fit_obliquity(
        points=[
            ObliquityPoint(oblique_angle=math.radians(degrees), strength_factor=strength)
            for degrees, strength in table_2()
        ]
    )


def _comparisons(fitted: ObliquityFit) -> list[Comparison]:
    names = ("γ₀", "γ₁", "γ₂")
    return [
        Comparison(
            what=f"eq. 9, {name}",
            ours=ours,
            reference=printed,
            unit=unit,
            tolerance=half,
            reference_source="eq. 9",
            note="tolerance: half of the last printed digit",
        )
        for name, ours, printed, unit, half in zip(
            names, fitted.coefficients, equation_9(), UNITS, HALF_DIGITS, strict=True
        )
    ]


def _table(fitted: ObliquityFit, own: dict[float, Estimate]) -> Table:
    rows = []
    for (degrees, printed), residual in zip(table_2(), fitted.residuals, strict=True):
        low, high = own[degrees].confidence_interval
        strength = own[degrees].strength_factor
        rows.append(
            (
                degrees,
                printed,
                printed - float(residual),
                float(residual),
                strength,
                f"{low:.2f} to {high:.2f}",
                strength - printed,
            )
        )
    return Table(
        name="table-2",
        caption="Table 2, the polynomial through it, and S fitted to our own finite element runs.",
        columns=["angle °", "Table 2", "polynomial", "left", "our finite elements", "95 % interval", "minus Table 2"],
        rows=rows,
    )


def _polynomial(fitted: ObliquityFit, degrees: FloatArray) -> FloatArray:
    return np.asarray(np.polynomial.polynomial.polyval(degrees, fitted.coefficients), dtype=np.float64)


def _figure(fitted: ObliquityFit, own: dict[float, Estimate]) -> Figure:
    points = np.array(table_2()).T
    strengths = np.array([each.strength_factor for each in own.values()])
    bounds = np.array([each.confidence_interval for each in own.values()]).T
    figure, (axes,) = style.panels(1, height=4.2)
    _draw_polynomial(axes, fitted)
    axes.plot(*points, "o", color=style.PAPER, markersize=7, label="Table 2 (LS-DYNA; at 0° tests)")
    axes.errorbar(
        list(own),
        strengths,
        yerr=np.abs(bounds - strengths),
        fmt="s",
        color=style.FINITE_ELEMENT,
        capsize=3,
        label="our finite elements (OpenRadioss), 95 %",
    )
    axes.set_ylim(0.0, 14.0)
    figure.legend(loc="outside lower center", ncols=2)
    series = {
        "polynomial": {"oblique_angle_deg": ANGLES, "strength_factor": _polynomial(fitted, ANGLES)},
        "table 2": {"oblique_angle_deg": points[0], "strength_factor": points[1]},
        "our finite elements": {
            "oblique_angle_deg": np.array(list(own)),
            "strength_factor": strengths,
            "lower": bounds[0],
            "upper": bounds[1],
        },
    }
    return Figure(
        name="figure-12",
        caption="Figure 12. Strength factor over the oblique angle: Table 2, the polynomial through it, and the S of "
        "our finite element runs. Dotted: the paper's critical angle.",
        figure=figure,
        data=stack("series", series),
    )


def _draw_polynomial(axes: Axes, fitted: ObliquityFit) -> None:
    """Draw the fitted polynomial, and where the paper uses it."""
    curve, inside = _polynomial(fitted, ANGLES), ANGLES <= 45.0
    axes.plot(ANGLES[inside], curve[inside], color=style.MODEL, label="second order through Table 2 (eq. 9)")
    axes.plot(ANGLES[~inside], curve[~inside], color=style.MODEL, linestyle="--", label="the same, extrapolated")
    critical = paper_value("critical_ricochet_angle_deg")
    axes.axvline(critical, color=style.HINT, linestyle=":", linewidth=1.0)
    axes.text(critical + 0.5, 0.94, f"{critical:g}°", transform=axes.get_xaxis_transform())
    axes.set(xlabel="oblique angle from the normal [°]", ylabel="strength factor S", xlim=(-1, 60))
