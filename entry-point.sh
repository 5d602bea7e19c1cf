#!/bin/sh
# Runs a command with the compiled code of the image that suits this processor: numba's variables choose it.
#   entry-point.sh COMMAND...           with the best code
#   entry-point.sh --each COMMAND...    once with each that runs here, to compile it
# Where they are set already, or no code suits, the command runs as it is, and compiles what it lacks.
set -eu

cpu=$(cat "${CPUINFO:-/proc/cpuinfo}")
flags=" $(printf '%s\n' "$cpu" | sed -n 's/^flags[^:]*://p' | head -n 1) "

has() {
    for flag; do
        case "$flags" in *" $flag "*) ;; *) return 1 ;; esac
    done
}

# AMD's processors with AVX-512 gain by registers of 512 bits, Intel's are faster with 256 (benchmarks/NOTES.md).
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
    # Zen 4's order of instructions, without what other processors with AVX-512 lack: they can compile it as well.
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
