"""Text of the comparison with finite elements."""

import math
from collections.abc import Mapping

from solver import Outcome
from solver.calibration import Estimate, MotionHistory
from validation.finite_elements_fits import (
    LATER,
    LAW_NAMES,
    LAWS,
    PAPER_ANGLES,
    RETAINED,
    TO_45,
    Calibration,
    Prediction,
    Predictions,
    ending,
    modelled_outcome,
)
from validation.reference import MESHES, Mesh, equation_9, finite_element_run, finite_element_runs

Brackets = Mapping[Mesh, tuple[float, float]]


def paragraphs(found: Mapping[Mesh, Calibration], predicted: Predictions, brackets: Brackets) -> tuple[str, ...]:
    """Return the paragraphs of the section.

    `brackets` has, for each mesh, the angles between which the outcome changes. [rad]
    """
    degrees = {mesh: (math.degrees(low), math.degrees(high)) for mesh, (low, high) in brackets.items()}
    return (
        _worth(),
        _verdict(degrees),
        _calibration(found["coarse"]),
        _laws(found),
        _outcomes(found),
        _rotation(found["coarse"]),
        _depths(found),
        _polynomial(found["coarse"], predicted),
        _angles(predicted, degrees),
        _extrapolation(predicted),
        _meaning(predicted),
        _cost(found["coarse"], predicted),
    )


def _worth() -> str:
    return (
        "An OpenRadioss model of the paper's strike, made for this project (Johnson-Holmquist concrete, cubes of "
        "10 mm where it is struck, no friction), stands where the paper had LS-DYNA; some runs were repeated with "
        "cubes of 7.5 mm. It knows nothing of this method: its one calibrated number, the strain at which elements go, "
        "was set on the depths of the four normal shots with the coarse mesh. It is worth 2 to 3 % at 15°, at 30° "
        "until arrest, and at every angle for the first 1 to 1.5 ms. **It is no converged answer late at large "
        "oblique angles**: after 2 ms at 45° and above allow ±4° in rotation and ±30 mm in position."
    )


def _verdict(brackets: Mapping[Mesh, tuple[float, float]]) -> str:
    coarse, fine = brackets["coarse"], brackets["fine"]
    last, first = ending(finite_element_run("oblique-48")), ending(finite_element_run("oblique-50"))
    refined = ending(finite_element_run("fine-oblique-48"))
    return (
        f"**Between {coarse[0]:g}° and {coarse[1]:g}° the coarse model changes from retained to turned away, the fine "
        f"one between {fine[0]:g}° and {fine[1]:g}°.** This is read from the velocities in the last row of each run: "
        f"turned away is what leaves with at least {100.0 * RETAINED:g} % of its energy. The coarse run at 50° has its "
        f"nose {first.tip_depth * 1e3:.0f} mm inside when it ends, but tip and centre of gravity move out, the tip at "
        f"{-first.tip_velocity:.0f} m/s, with {100.0 * first.energy_share:.0f} % of the energy; so does the fine run "
        f"at 48°, at {-refined.tip_velocity:.0f} m/s. The coarse run at 48° is the least certain: at its end, 5 ms, it "
        f"slides {last.tip_depth * 1e3:.0f} mm deep with {100.0 * last.energy_share:.0f} % of its energy, its centre "
        f"of gravity still sinking at {last.center_velocity:.0f} m/s while the tip rises at {-last.tip_velocity:.0f} "
        "m/s."
    )


def _calibration(found: Calibration) -> str:
    listed = [
        ", ".join(f"{short(each)} at {angle:g}°" for angle, each in found.factors(law).items() if angle > 0.0)
        for law in LAWS
    ]
    names = [LAW_NAMES[law] for law in LAWS]
    return (
        "As in the paper's section 3, S is fitted to greatest depths at 0° and to the motion elsewhere, to depth, "
        "lateral displacement and rotation together, each scaled by its span, **at every angle of the runs and not up "
        "to 45° only**. The fit ends when the nose tip is deepest: without friction an embedded projectile is squeezed "
        "back after that, and at 45° the tail sinks on to the end of the run. With the coarse mesh S is "
        f"{listed[0]} ({names[0]}), and {listed[1]} ({names[1]}); standard errors, the table has the finer mesh. At 0° "
        f"it is {short(found.by_depth.estimate)} with every law, for a normal shot feels no free surface."
    )


def _laws(found: Mapping[Mesh, Calibration]) -> str:
    coarse, fine = found["coarse"], found["fine"]
    rms = {law: coarse.normalized_root_mean_square(law) for law in LAW_NAMES}
    later = {law: coarse.normalized_root_mean_square(law, later=True) for law in LAWS}
    plain, other = coarse.own("elastic_plastic"), coarse.own("mohr_coulomb")
    better = [
        f"{plain[angle].normalized_root_mean_square / other[angle].normalized_root_mean_square:.1f} at {angle:g}°"
        for angle in plain
    ]
    steep = [1e3 * float(fit.predicted.time[-1]) for angle, fit in plain.items() if angle > PAPER_ANGLES[-1]]
    return (
        f"**{LAW_NAMES[coarse.fits.best]} decay follows the motions best.** The normalised root mean square over all "
        f"{len(coarse.runs)} oblique runs with the coarse mesh, each at its own S, is {rms['mohr_coulomb']:.3f} with "
        f"Mohr-Coulomb, {rms['elastic_plastic']:.3f} with elastic-plastic decay and {rms['none']:.3f} with none; over "
        f"the {len(fine.runs)} with the fine mesh "
        f"{', '.join(f'{fine.normalized_root_mean_square(law):.3f}' for law in ('mohr_coulomb', 'elastic_plastic'))} "
        f"and {fine.normalized_root_mean_square('none'):.3f}. Fitted until the centre of gravity is deepest, which at "
        f"large oblique angles takes in the skid, they are {later['mohr_coulomb']:.3f} and "
        f"{later['elastic_plastic']:.3f} with the coarse mesh. It is not so at every angle: the root mean square of "
        f"elastic-plastic over that of Mohr-Coulomb decay is {', '.join(better)}. From 48° on, where the tip is "
        f"deepest after {min(steep):.1f} to {max(steep):.1f} ms, the elastic-plastic law follows these first "
        "milliseconds better. With one S for all angles the laws differ less, for S falls with the angle in both."
    )


def _outcomes(found: Mapping[Mesh, Calibration]) -> str:
    right, wrong = {}, []
    for law in LAWS:
        missed = [
            f"{run.degrees:g}° ({mesh})"
            for mesh, calibration in found.items()
            for run in calibration.runs
            if outcomes(calibration, law)[run.degrees] != ending(run).turned_away
        ]
        total = sum(len(calibration.runs) for calibration in found.values())
        right[law] = f"{total - len(missed)} of {total} with {LAW_NAMES[law]} decay"
        if missed:
            wrong.append(f"{LAW_NAMES[law]} misses {', '.join(missed)}")
    return (
        "At the S fitted to a run, which knows nothing of how the run ends, the model reproduces the outcome of "
        f"{' and '.join(right.values())}{': ' if wrong else ''}{'; '.join(wrong)}."
    )


def _rotation(found: Calibration) -> str:
    fits = {law: [found.own(law)[angle] for angle in PAPER_ANGLES] for law in LAWS}
    turned = [
        f"{', '.join(f'{_turned(fit.predicted):.1f}°' for fit in fits[law])} with {LAW_NAMES[law]} decay"
        for law in LAWS
    ]
    computed = [f"{_turned(fit.predicted) + _turned(fit.residuals):.1f}°" for fit in fits["elastic_plastic"]]
    alone = [
        f"{', '.join(_factor(found.alone[law][angle]['rotation']) for angle in PAPER_ANGLES)} alone by rotation and "
        f"{', '.join(_factor(found.alone[law][angle]['depth_displacement']) for angle in PAPER_ANGLES)} by depth with "
        f"{LAW_NAMES[law]} decay"
        for law in LAWS
    ]
    return (
        "**One number does not serve all three quantities.** When the tip is deepest, at 15°, 30° and 45°, the finite "
        f"elements have turned by {', '.join(computed)}; the model at the fitted S has turned by "
        f"{' and by '.join(turned)}. S is {'; '.join(alone)}. The "
        "elastic-plastic law stops turning when its shank bears on the concrete, which resists with S f'c in full at "
        "any speed; the finite elements, with eroded room around the shank, turn on. Mohr-Coulomb decay weakens the "
        "concrete further from the face, and lets the body turn. The intervals count neighbours in a history as alike, "
        "but an error of this kind is not in them."
    )


def _depths(found: Mapping[Mesh, Calibration]) -> str:
    coarse, fine = (found[mesh].by_depth for mesh in MESHES)
    return (
        f"From the four greatest depths in normal impact S is {short(coarse.estimate)}, with residuals from "
        f"{_signed(coarse.residuals.max() * 1e3, 0)} mm at the slowest to {_signed(coarse.residuals.min() * 1e3, 0)} "
        "mm at the fastest: the depth of the finite elements grows less with speed than eq. 1 says. The finer mesh has "
        f"two normal shots, {short(fine.estimate)}. The erosion strain was set with the coarse mesh; at 369.5 m/s the "
        f"fine one goes {_deeper():.0f} mm deeper."
    )


def _deeper() -> float:
    """Return the depth of the fastest normal shot with the fine mesh minus that with the coarse mesh. [mm]"""
    fine, coarse = (finite_element_run(name) for name in ("fine-normal-369.5", "normal-369.5"))
    return 1e3 * float(fine.depth_displacement.max() - coarse.depth_displacement.max())


def _polynomial(found: Calibration, predicted: Predictions) -> str:
    texts = []
    for law in LAWS:
        fit = predicted.chosen(law, "coarse").fit
        if fit is not None:
            c = fit.coefficients
            texts.append(f"{c[0]:.3f} {_signed(c[1], 4)} θ {_signed(c[2], 5)} θ² ({LAW_NAMES[law]})")
    paper = equation_9()
    return (
        "The polynomial of eq. 9 through all points of the coarse mesh is S(θ) = "
        f"{' and '.join(texts)}, **all points weighing alike**; the paper's is {paper[0]:g} {_signed(paper[1], 4)} θ "
        f"{_signed(paper[2], 4)} θ². By their standard errors a few points would have most of the weight, but those do "
        "not hold the error of the model. The covariance, and so the standard error of an angle, follows from the "
        f"scatter of the {len(found.factors('elastic_plastic'))} points about the polynomial."
    )


def _angles(predicted: Predictions, brackets: Mapping[Mesh, tuple[float, float]]) -> str:
    parts = [
        f"{_answer(predicted.chosen(law, mesh))} by {LAW_NAMES[law]} decay, "
        f"{placed(predicted.chosen(law, mesh), *brackets[mesh])}"
        for mesh in MESHES
        for law in LAWS
    ]
    (low, high), (fine_low, fine_high) = brackets["coarse"], brackets["fine"]
    return (
        f"**Critical angle with S from all runs of a mesh.** Coarse mesh, finite elements between {low:g}° and "
        f"{high:g}°: {parts[0]}; {parts[1]}. Fine mesh, between {fine_low:g}° and {fine_high:g}°: {parts[2]}; "
        f"{parts[3]}. "
        f"With the paper's eq. 9, fitted to other finite elements up to 45° and extrapolated, the elastic-plastic law "
        f"gives {_answer(predicted.paper)}."
    )


def _extrapolation(predicted: Predictions) -> str:
    parts = []
    for law in LAWS:
        answers = [
            f"{_answer(each)} on the {mesh} one"
            for mesh in MESHES
            for each in [predicted.of(law, mesh, TO_45)]
            if each.extrapolated
        ]
        parts.append(f"{LAW_NAMES[law]} {' and '.join(answers)}")
    wild = predicted.of("mohr_coulomb", "coarse", TO_45)
    factor = "" if wild.factor is None else f", where S has fallen to {wild.factor:.2f}"
    return (
        "**What extrapolation does.** Calibrated up to 45° only, as the paper's eq. 9, the angle takes S from beyond "
        f"the fitted angles: {'; '.join(parts)}. The Mohr-Coulomb value on the coarse mesh{factor}, is no answer, and "
        "the elastic-plastic one is higher than with S fitted up to 55°. The table marks every reading that "
        "extrapolates; the figure draws the polynomials between the fitted angles only."
    )


def _answer(prediction: Prediction) -> str:
    if prediction.degrees is None:
        return f"none (`{prediction.answer.status.value}`)"
    error = prediction.error_degrees
    return f"{prediction.degrees:.1f}°" + ("" if error is None else f" ± {error:.1f}°")


def with_extrapolation(prediction: Prediction) -> str:
    """Return a critical angle with its standard error as text, with a note if S is extrapolated."""
    return _answer(prediction) + (", extrapolated" if prediction.extrapolated else "")


def outcomes(calibration: Calibration, law: str) -> dict[float, bool]:
    """Return, by oblique angle [°], whether the model predicts ricochet with the S fitted to the run at that angle."""
    runs = {run.degrees: run for run in calibration.runs}
    return {
        angle: modelled_outcome(runs[angle], strength_factor=fit.estimate.strength_factor, free_surface=LAWS[law])
        is Outcome.RICOCHET
        for angle, fit in calibration.own(law).items()
    }


def placed(prediction: Prediction, low: float, high: float) -> str:
    """Return where a predicted angle lies relative to the bracket of the finite elements, as text. [°]"""
    return place(prediction.degrees, prediction.error_degrees, low, high)


def place(angle: float | None, error: float | None, low: float, high: float) -> str:
    """Return where an angle lies relative to two others, as text. [°]"""
    if angle is None:
        return "which cannot be compared"
    if low <= angle <= high:
        return "between these"
    where = f"{angle - high:.1f}° above both" if angle > high else f"{low - angle:.1f}° below both"
    if error is None:
        return where
    nearest = min(abs(angle - low), abs(angle - high))
    return f"{where}, {'less' if nearest < error else 'more'} than its standard error"


def _meaning(predicted: Predictions) -> str:
    spans = []
    for law in LAWS:
        angles = [
            each.degrees
            for each in predicted.each
            if each.law == law and each.mesh is not None and not each.extrapolated and each.degrees is not None
        ]
        spans.append(f"{min(angles):.1f}° to {max(angles):.1f}° with {LAW_NAMES[law]} decay")
    moved = [
        abs(cut.degrees - chosen.degrees)
        for law in LAWS
        for mesh in MESHES
        for cut, chosen in [(predicted.of(law, mesh, LATER), predicted.chosen(law, mesh))]
        if cut.degrees is not None and chosen.degrees is not None
    ]
    return (
        "**What this is worth.** Readings of the calibration that do not extrapolate spread over "
        f"{' and '.join(spans)}; whether a history is cut at the deepest nose tip or centre of gravity moves the angle "
        f"by up to {max(moved):.1f}°. The finite elements' own angle falls by two to three degrees with refinement and "
        "is not settled. The histories near the critical angle agree for the first 2 ms; after that the finite "
        "elements slide on, where the model comes to rest or is thrown out sooner. Agreement within a few degrees can "
        "be claimed, none to the degree, and it is agreement between two computations: no test of this angle is known."
    )


def _cost(found: Calibration, predicted: Predictions) -> str:
    runs = finite_element_runs("coarse")
    spent, search = sum(run.cpu_seconds or 0.0 for run in runs), predicted.paper.cpu_seconds
    near = sum(run.cpu_seconds or 0.0 for run in runs if run.degrees > PAPER_ANGLES[-1])
    times = float(f"{near / search:.1g}")
    return (
        f"**Cost.** The runs at 48° to 55° took {near:,.0f} CPU s of finite elements; a critical angle at known S "
        f"takes {search * 1e3:.0f} ms here, some {times:,.0f} times less. The calibration is not free of them: the "
        f"{len(runs)} runs with the coarse mesh took {spent:,.0f} CPU s, and the fits with three laws "
        f"{found.cpu_seconds:.1f}. What is saved is every further angle, speed and size for which the same S is taken "
        "to hold."
    )


def short(estimate: Estimate) -> str:
    """Return a strength factor and its standard error as text."""
    return f"{estimate.strength_factor:.2f} ± {estimate.standard_error:.2f}"


def _factor(estimate: Estimate | None) -> str:
    return "none" if estimate is None else f"{estimate.strength_factor:.1f}"


def _turned(motion: MotionHistory) -> float:
    """Return the rotation in the last row of a history; nan if the history has no rotation. [°]"""
    return math.nan if motion.rotation is None else math.degrees(float(motion.rotation[-1]))


def _signed(value: float, decimals: int) -> str:
    return f"{value:+.{decimals}f}".replace("-", "\N{MINUS SIGN}")
