"""Processors that code is compiled for: the one of this machine, or one of a few levels that many processors share.

A wheel for one platform (`make wheel`) and the container image carry code for x86-64-v3, the processors with AVX2, and
for AMD's with AVX-512, which gain a tenth to a fifth by registers of 512 bits (`benchmarks/NOTES.md`).
"""

import platform
from typing import NamedTuple

from llvmlite.binding import get_host_cpu_features, get_host_cpu_name


class Processor(NamedTuple):
    """A level of processors: code compiled for it runs on every processor that has these features."""

    name: str
    """Value of `NUMBA_CPU_NAME`, a processor that LLVM knows."""
    features: str = ""
    """Value of `NUMBA_CPU_FEATURES`, features to switch on (+) or off (-)."""
    needs: tuple[str, ...] = ()
    """Features that a processor must have to run the code."""
    gain: tuple[str, ...] = ("",)
    """First letters of LLVM's names of the processors on which this code is the fastest."""

    @property
    def runs_here(self) -> bool:
        """Whether this machine can run the code."""
        host = get_host_cpu_features()
        return all(host.get(feature) for feature in self.needs)

    @property
    def suits_here(self) -> bool:
        """Whether this is also the fastest code for it."""
        return self.runs_here and get_host_cpu_name().startswith(self.gain)


WITH_512_BITS = ("znver4", "znver5")
"""Processors on which LLVM uses registers of 512 bits; on those of Intel, 256 bits are as fast."""
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
