"""Elementary functions in plain double arithmetic: the same bits on every processor.

A libm depends on its version and on what the processor can do (glibc uses fused multiply-add where there is one), so a
run recorded with it can be repeated on one machine only. These functions use +, -, *, / and sqrt, which IEEE 754 rounds
correctly everywhere, comparisons and the bits of a number, and nothing else. Compiled code must not contract products
and sums (numba does not unless asked to; in C: `-ffp-contract=off`).

Algorithms and coefficients of exp, expm1, log, sin, cos, tan, atan and atan2 are those of fdlibm (Freely Distributable
LIBM, Sun Microsystems 1993: "Permission to use, copy, modify, and distribute this software is freely granted, provided
that this notice is preserved"), rewritten; those of tanh are of the Cephes library (S. L. Moshier 1984 to 2000, free to
use, distributed under a BSD licence in SciPy). hypot and pow use exact products and sums of two doubles (Dekker 1971),
the reduction of very large angles is Payne and Hanek's (1983). Errors are bounds against the exact value, in units in
the last place; in brackets the largest that `benchmarks/accuracy.py` finds at 10^7 points.

    exp (0.89), expm1 (0.85), log (0.85), sin (0.78), cos (0.78), tan (0.87), atan (0.81), hypot (0.86)      1 ulp
    tanh (1.31), atan2 (1.50), pow (0.88)                                                                    2 ulp

`arrays` has the same for arrays, `matrices` small linear algebra without a BLAS, `normals` numpy's normal numbers.

Special values are those of IEEE 754 and C99's Annex F; nothing is raised. With `NUMBA_DISABLE_JIT=1` the same text runs
as plain Python and gives the same bits.
"""

from .angles import atan, atan2, cos, cos_sin, nearest_turn, sin, tan
from .exponentials import exp, expm1, log, sigmoids, tanh
from .two_doubles import hypot, pow

__all__ = [
    "atan", "atan2", "cos", "cos_sin", "exp", "expm1", "hypot", "log", "nearest_turn", "pow", "sigmoids", "sin", "tan",
    "tanh",
]  # fmt: skip
