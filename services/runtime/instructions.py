"""One set of processor instructions for the libraries that compute, so that results do not depend on the processor.

OpenBLAS and numpy take the widest instructions of the processor that they run on. With others, the last bits of a
result differ, and a planner that optimises may then take another tour. Nearly every x86-64 processor since 2015 has the
instructions of x86-64-v3 (AVX2, FMA); to these the libraries are held. Elsewhere they choose for themselves.

Like `services.runtime.entry`, this is used before numpy is imported, and imports nothing that is slow.
"""

from __future__ import annotations

import os

X86_64_V3 = "x86-64-v3"
_NEEDED = frozenset({"avx2", "fma", "bmi2"})


def instructions() -> str:
    """What the libraries of this host compute with: `X86_64_V3`, or the machine's name where they choose themselves."""
    return X86_64_V3 if _flags() >= _NEEDED else os.uname().machine if hasattr(os, "uname") else "unknown"


def common_instructions() -> dict[str, str]:
    """Environment variables that hold OpenBLAS and numpy to the instructions of x86-64-v3; none on other processors."""
    flags = _flags()
    if not flags >= _NEEDED:
        return {}
    held = {"OPENBLAS_CORETYPE": "Haswell"}
    if "avx512f" in flags:  # numpy warns of what cannot be switched off because it is not there
        held["NPY_DISABLE_CPU_FEATURES"] = "X86_V4 AVX512_ICL AVX512_SPR"
    return held


def _flags() -> frozenset[str]:
    """The features of the processor, as Linux names them for x86-64; empty on other systems and processors."""
    try:
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as cpuinfo:  # noqa: PTH123 - pathlib is slow
            for line in cpuinfo:
                name, _, words = line.partition(":")
                if name.strip() == "flags":
                    return frozenset(words.split())
    except OSError:
        pass
    return frozenset()
