"""Where a piece of outline is cut into stretches on which the loaded arcs change smoothly, and how they are loaded.

Cuts are where the face, or the line on which elements start to separate, crosses the top or the bottom of a ring.
"""

import math

from solver.arrays import FloatArray, arc_cosine, sine
from solver.compilation import lean
from solver.surface import ARC

HALF_TURN = math.pi / 2.0
MAX_CUTS = 8
"""Ends of the stretches of one outline piece: two ends and at most six crossings."""

Motion = tuple[float, float, float, float, float, float]
"""Depth of the centre of gravity, cosine and sine of the axis angle; velocities along and across the axis, and spin."""
Ring = tuple[float, float, float, float]
"""Sine and cosine of α, axial position and radius."""


@lean
def insert(cuts: FloatArray, count: int, value: float, upper: float) -> int:
    """Put `value` in its place among the sorted `cuts`, if it lies inside; return how many there are."""
    if not cuts[0] < value < upper:
        return count
    place = count
    while cuts[place - 1] > value:
        cuts[place] = cuts[place - 1]
        place -= 1
    cuts[place] = value
    return count + 1


@lean
def _cut_arc(cuts: FloatArray, piece: FloatArray, motion: Motion) -> int:
    """Angles α at which the face or the separation line crosses the top or bottom of a circular piece."""
    depth, c, s, forward, sideways, spin = motion
    axial, radius, size, upper = piece[1], piece[2], piece[3], piece[5]
    angle = arc_cosine(c)
    cuts[0] = piece[4]
    count = 1
    for side in (-1.0, 1.0):
        height = (side * radius * s - depth - axial * c) / size
        if abs(height) < 1.0:
            root = HALF_TURN - arc_cosine(height)
            for crossing in (side * angle + root, side * angle + math.pi - root):
                count = insert(cuts, count, crossing if crossing <= math.pi else crossing - 2.0 * math.pi, upper)
        separation = math.atan(-side * (sideways + spin * axial) / (forward - side * spin * radius))
        count = insert(cuts, count, separation, upper)
    cuts[count] = upper
    return count


@lean
def _cut_line(cuts: FloatArray, piece: FloatArray, motion: Motion) -> int:
    """Distances along a straight piece at which they do."""
    depth, c, s, forward, sideways, spin = motion
    axial, radius, length, sine_, cosine = piece[1], piece[2], piece[3], piece[4], piece[5]
    cuts[0] = 0.0
    count = 1
    across = (sideways + spin * axial) * cosine - spin * radius * sine_
    for side in (-1.0, 1.0):
        slope = cosine * c + side * sine_ * s
        if slope != 0.0:
            count = insert(cuts, count, (depth + axial * c - side * radius * s) / slope, length)
        if spin != 0.0:
            count = insert(cuts, count, (side * forward * sine_ + across) / spin, length)
    cuts[count] = length
    return count


@lean
def ring_at(piece: FloatArray, place: float) -> Ring:
    """The ring at a place on a piece."""
    if piece[0] == ARC:
        sine_, half = sine(place), sine(0.5 * place)
        cosine = 1.0 - 2.0 * half * half
        return sine_, cosine, piece[1] + piece[3] * sine_, piece[2] + piece[3] * cosine
    return piece[4], piece[5], piece[1] - place * piece[5], piece[2] + place * piece[4]


@lean
def cut(cuts: FloatArray, piece: FloatArray, motion: Motion) -> int:
    """Write the sorted ends of the stretches of a piece; return how many stretches there are."""
    return _cut_arc(cuts, piece, motion) if piece[0] == ARC else _cut_line(cuts, piece, motion)


@lean
def is_loaded(ring: Ring, motion: Motion) -> bool:
    """Whether any of a ring is below the face, and any of it moves into the target."""
    sine, _, axial, radius = ring
    depth, c, s, forward, _, _ = motion
    return depth + axial * c + radius * s > 0.0 and forward * sine + abs(_turning(ring, motion)) > 0.0


@lean
def _turning(ring: Ring, motion: Motion) -> float:
    """How the normal velocity grows with cos β."""
    sine, cosine, axial, radius = ring
    _, _, _, _, sideways, spin = motion
    return (sideways + spin * axial) * cosine - spin * radius * sine


@lean
def _faces_in(ring: Ring, motion: Motion) -> bool:
    """Whether all of its normals point into the target."""
    return ring[0] * motion[1] >= ring[1] * motion[2]


@lean
def _dips_in(ring: Ring, motion: Motion) -> bool:
    """Whether those below the face do, as its own meets the axis above the face."""
    sine, cosine, axial, radius = ring
    depth, c, _, _, _, _ = motion
    return radius * sine * c >= (depth + axial * c) * cosine


@lean
def is_full(piece: FloatArray, begin: float, end: float, middle: Ring, motion: Motion) -> bool:
    """Whether a stretch, of which the ring in its middle is known, is resisted in full wherever it is loaded.

    The shank is where it moves sideways into the target. Elsewhere what holds at both ends of a stretch holds within:
    α and where the normals meet the axis change in one direction only.
    """
    if middle[0] == 0.0 and _turning(middle, motion) < 0.0:
        return True
    if not (_faces_in(middle, motion) or _dips_in(middle, motion)):
        return False
    first = ring_at(piece, begin)
    return _faces_in(first, motion) or (_dips_in(first, motion) and _dips_in(ring_at(piece, end), motion))
