#!/bin/sh
# Runs a command with the compiled code of the image that suits this processor, which numba's variables select.
#   entry-point.sh COMMAND...           with the best code for this processor
#   entry-point.sh --each COMMAND...    once for each kind of processor whose code can run here, to compile that code
# If the variables are set already, or no code suits, the command runs without changes, and compiles code that is missing.
set -eu

cpu=$(cat "${CPUINFO:-/proc/cpuinfo}")
flags=" $(printf '%s\n' "$cpu" | sed -n 's/^flags[^:]*://p' | head -n 1) "

has() {
    for flag; do
        case "$flags" in *" $flag "*) ;; *) return 1 ;; esac
    done
}

# With AVX-512, AMD's processors are faster with 512-bit registers, and Intel's with 256-bit ones (benchmarks/NOTES.md).
suits=
runs=
if has avx2 bmi1 bmi2 f16c fma abm movbe; then
    runs=x86-64-v3 suits=x86-64-v3
    if has avx512f avx512bw avx512cd avx512dq avx512vl; then
        runs="x86-64-v3 skylake-avx512 znver4"
        case "$cpu" in *AuthenticAMD*) suits=znver4 ;; *) suits=skylake-avx512 ;; esac
    fi
fi

choose() {
    export NUMBA_CPU_NAME="$1" NUMBA_CPU_FEATURES=
    # Schedule instructions for Zen 4, but leave out those that other processors with AVX-512 lack, so that they can compile this code too.
    if [ "$1" = znver4 ]; then
        NUMBA_CPU_FEATURES=-sse4a,-gfni,-avx512bf16,-avx512bitalg,-avx512ifma
        NUMBA_CPU_FEATURES=$NUMBA_CPU_FEATURES,-avx512vbmi,-avx512vbmi2,-avx512vnni,-avx512vpopcntdq
    fi
}

if [ "$1" = --each ]; then
    shift
    for name in $runs; do
        (choose "$name" && "$@")
    done
    exit
fi
if [ -n "$suits" ] && [ -z "${NUMBA_CPU_NAME:-}" ]; then choose "$suits"; fi
exec "$@"
