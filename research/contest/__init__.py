"""The contest: all controllers on all tasks with several seeds, judged by what they track, learn and know."""
