"""What processors code is compiled for: the one at hand, or one of a few that many are like.

A wheel for one platform (`make wheel`) and the container image carry code for x86-64-v3, the processors with AVX2, and
for AMD's with AVX-512, which gain a tenth to a fifth by registers of 512 bits (`benchmarks/NOTES.md`).
"""

import platform
from typing import NamedTuple

from llvmlite.binding import get_host_cpu_features, get_host_cpu_name


class Processor(NamedTuple):
    """Something that code can be compiled for and carried to others."""

    name: str
    """LLVM's, of `NUMBA_CPU_NAME`."""
    features: str = ""
    """Likewise, of `NUMBA_CPU_FEATURES`."""
    needs: tuple[str, ...] = ()
    """Features of those that can run it."""
    gain: tuple[str, ...] = ("",)
    """How LLVM's names of those begin that gain by it."""

    @property
    def runs_here(self) -> bool:
        """Whether this machine can run the code."""
        host = get_host_cpu_features()
        return all(host.get(feature) for feature in self.needs)

    @property
    def suits_here(self) -> bool:
        """Whether it also gains by it."""
        return self.runs_here and get_host_cpu_name().startswith(self.gain)


WITH_512_BITS = ("znver4", "znver5")
"""Names of processors on which LLVM is to use registers of 512 bits: on Intel's, half of that is as fast."""
AVX2 = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
AVX512 = ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl")
PORTABLE = (
    (
        Processor("x86-64-v4", "-prefer-256-bit", AVX2 + AVX512, WITH_512_BITS),
        Processor("x86-64-v3", "", AVX2),
    )
    if platform.machine() in {"x86_64", "AMD64"}
    else (Processor("generic"),)
)
"""The best first."""
