"""Down to a microcontroller: the control step as readable C99, written from the compiled functions' own source.

    a stepper's memory ─▶ program: what is known ─▶ body, calls, expressions: lines of C ─▶ files ─▶ self-test

`board` says what a sample does, `program` follows all calls from there. What Python knows when C is written (sizes,
offsets, kinds) becomes numbers in its text; what is never written becomes a constant table; everything else is one
struct. `golden` asks the stepper for the answers that the self-test compares with, bit for bit.
"""

from .export import Embedded, embed

__all__ = ["Embedded", "embed"]
