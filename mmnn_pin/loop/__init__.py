"""The loop closed: one control sample, the engines that repeat it, and the stepper for a loop of one's own.

Read `sample` first, one control sample, then `loop`, which repeats it and records. `ordinary` and `compiled` are the
two engines, `stepper` is the sample for a robot outside; `torque.law` is what they ask of a compiled controller. The
other modules are each one part of what a loop is made from, and can be left for when they are met.
"""
