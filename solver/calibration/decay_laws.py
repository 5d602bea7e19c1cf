"""Comparison of the decay laws by their fit to the motions of oblique strikes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from solver.calibration.history import MotionRun
from solver.calibration.motion import MotionsFit, fit_motions
from solver.calibration.strength_factor import UndeterminedError
from solver.free_surface import FreeSurface, decay_laws
from solver.projectile import Projectile
from solver.resistance import Resistance, usual_unless_given
from solver.strike import Numerics
from solver.target import Target
from solver.warnings import ModelWarning

# Laws whose misfits differ by less than a fifth fit a motion about equally well; the value is arbitrary.
BETTER = 0.8
"""Ratio of the normalised root mean square of the best law to that of the requested law, below which a warning appears.
[1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class DecayLawFits:
    """Fits of the same motions with each decay law."""

    requested: MotionsFit
    """Fit with the law of the given resistance."""
    laws: Mapping[str, MotionsFit | None]
    """Fits by name of the law; None for a law with which the motions do not determine the strength factor."""
    warnings: tuple[ModelWarning, ...]
    """Warnings about the fit with the requested law, and a warning if another law fits much better."""

    @property
    def best(self) -> str:
        """Name of the law with the smallest normalised root mean square."""
        return _best(self.laws)


def fit_decay_laws(
    *,
    projectile: Projectile,
    target: Target,
    runs: Sequence[MotionRun],
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    confidence_level: float = 0.95,
) -> DecayLawFits:
    """Fit the motions of runs with each decay law: elastic-plastic, Mohr-Coulomb and none.

    Parameters
    ----------
    projectile, target, runs, numerics, confidence_level
        As for `fit_motions`.
    resistance
        Inertia factor and requested decay law; the other laws include inertia if this one does. Its strength factor is
        not used.

    Returns
    -------
    DecayLawFits

    Raises
    ------
    ParameterError
        If an input is outside its range, or the runs do not determine the strength factor with the requested law.

    Examples
    --------
    >>> found = fit_decay_laws(projectile=projectile, target=target, runs=[MotionRun(impact=impact, history=history)])
    >>> {name: fit.normalized_root_mean_square for name, fit in found.laws.items() if fit}
    >>> found.best
    """
    resistance = usual_unless_given(resistance)

    def fitted(law: FreeSurface) -> MotionsFit:
        return fit_motions(
            projectile=projectile,
            target=target,
            runs=runs,
            resistance=replace(resistance, free_surface=law),
            numerics=numerics,
            confidence_level=confidence_level,
        )

    requested = fitted(resistance.free_surface)
    laws: dict[str, MotionsFit | None] = {}
    for law in decay_laws(inertia=getattr(resistance.free_surface, "inertia", False)):
        if law.name == resistance.free_surface.name:
            laws[law.name] = requested
            continue
        try:
            laws[law.name] = fitted(law)
        except UndeterminedError:
            laws[law.name] = None
    return DecayLawFits(
        requested=requested, laws=laws, warnings=(*requested.warnings, *_other_law_warnings(requested, laws))
    )


def _best(laws: Mapping[str, MotionsFit | None]) -> str:
    return min((fit.normalized_root_mean_square, name) for name, fit in laws.items() if fit is not None)[1]


def _other_law_warnings(requested: MotionsFit, laws: Mapping[str, MotionsFit | None]) -> list[ModelWarning]:
    name = _best(laws)
    best = laws[name]
    if best is None or best.normalized_root_mean_square >= BETTER * requested.normalized_root_mean_square:
        return []
    detail = (
        f"{name} fits with a normalised root mean square of {best.normalized_root_mean_square:.2g}, "
        f"{requested.free_surface.name} with {requested.normalized_root_mean_square:.2g}"
    )
    return [ModelWarning("other_decay_law_fits_better", detail)]
