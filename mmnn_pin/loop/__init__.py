"""The loop closed: one control sample, the engines that repeat it, and the stepper for a loop of one's own."""
