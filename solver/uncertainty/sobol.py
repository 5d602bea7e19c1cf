"""Scrambled Sobol points, identical to SciPy's.

`scipy.stats.qmc.Sobol` returns the same points, but `scipy.stats` takes longer to import than a small study to run.
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from solver.arrays import FloatArray

# SciPy uses this number, and a test compares the points with SciPy's to the last bit.
BITS = 30
"""Number of binary digits of a coordinate."""
JOE_KUO = """
3 1, 7 1 3, 11 1 3 1, 13 1 1 1, 19 1 1 3 3, 25 1 3 5 13, 37 1 1 5 5 17, 41 1 1 5 5 5, 47 1 1 7 11 19, 55 1 1 5 1 1,
59 1 1 1 3 11, 61 1 3 5 5 31, 67 1 3 3 9 7 49, 91 1 1 1 15 21 21, 97 1 3 1 13 27 49, 103 1 1 1 15 7 5,
109 1 3 1 15 13 25, 115 1 1 5 5 19 61, 131 1 3 7 11 23 15 103, 137 1 3 7 13 13 15 69, 143 1 1 3 13 7 35 63,
145 1 3 5 9 1 25 53, 157 1 3 1 13 9 35 107, 167 1 3 1 5 27 61 31, 171 1 1 5 11 19 41 61, 185 1 3 5 3 3 13 69,
191 1 1 7 13 1 19 1, 193 1 3 7 5 13 19 59, 203 1 1 3 9 25 29 41, 211 1 3 5 13 23 1 55, 213 1 3 7 3 13 59 17,
229 1 3 1 3 5 53 69, 239 1 1 5 5 23 33 13, 241 1 1 7 7 1 61 123, 247 1 1 7 9 13 61 49, 253 1 3 3 5 3 55 33,
285 1 3 1 15 31 13 49 245, 299 1 3 5 15 31 59 63 97, 301 1 3 1 11 11 11 77 249, 333 1 3 1 11 27 43 71 9,
351 1 1 7 15 21 11 81 45, 355 1 3 7 3 25 31 65 79, 357 1 3 1 1 19 11 3 205, 361 1 1 5 9 19 21 29 157,
369 1 3 7 11 1 33 89 185, 391 1 3 3 3 15 9 79 71, 397 1 3 7 11 15 39 119 27
"""
"""Primitive polynomial and first direction numbers of each dimension after the first, from the file new-joe-kuo-6 of
Joe and Kuo (2008, doi:10.1137/070709359). The bits of the polynomial are its coefficients, highest power first."""
MOST_DIMENSIONS = 2 + JOE_KUO.count(",")
"""Largest number of dimensions; the table has all but the first."""


@lru_cache(1)
def direction_numbers() -> npt.NDArray[np.uint32]:
    """Return the (dimensions, bits) direction numbers, each with its first digit in the highest bit."""
    # This is Bratley and Fox's recurrence (1988) for a primitive polynomial modulo 2.
    numbers = [[1] * BITS]
    for row in JOE_KUO.split(","):
        polynomial, *found = map(int, row.split())
        degree = len(found)
        for place in range(degree, BITS):
            number = found[place - degree]
            for power in range(1, degree + 1):
                if polynomial >> (degree - power) & 1:
                    number ^= found[place - power] << power
            found.append(number)
        numbers.append(found)
    return np.array(numbers, np.uint32) << np.arange(BITS - 1, -1, -1, dtype=np.uint32)


def scrambled_sobol(generator: np.random.Generator, dimensions: int, count: int) -> FloatArray:
    """Return (count, dimensions) points in [0, 1).

    Random lower triangular matrices and a digital shift scramble the sequence (Matousek 1998,
    doi:10.1006/jcom.1998.0489), which preserves its balance.

    Parameters
    ----------
    dimensions
        Number of dimensions, at most `MOST_DIMENSIONS`.
    count
        Number of points, a power of two below 2**30. The first points do not depend on it.
    """
    (generator,) = generator.spawn(1)  # as in SciPy, so that the points are the same
    digits = np.arange(BITS, dtype=np.uint32)
    shift = generator.integers(2, size=(dimensions, BITS), dtype=np.uint32) @ (np.uint32(1) << digits)
    matrices = np.tril(generator.integers(2, size=(dimensions, BITS, BITS), dtype=np.uint32), -1)
    matrices |= np.eye(BITS, dtype=np.uint32)
    from_first = digits[::-1]
    columns = np.bitwise_or.reduce(matrices << from_first[:, None], axis=1)
    own = direction_numbers()[:dimensions, :, None] >> from_first & 1
    # The product modulo 2 of a matrix and the digits of a number is the exclusive or of the columns whose digit is 1.
    numbers = np.bitwise_xor.reduce(np.where(own, columns[:, None], 0), axis=-1)
    points = np.empty((count, dimensions), np.uint32)
    points[0] = shift
    for bit in range(count.bit_length() - 1):
        # In Gray code, the second half of a sequence is the first half in reverse order with one more digit, so whole
        # halves are computed at once.
        half = 1 << bit
        points[half : 2 * half] = points[half - 1 :: -1] ^ numbers[:, bit]
    return points.astype(float) * 2.0**-BITS
