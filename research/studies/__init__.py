"""Studies that are too long for an experiment: scripts with results, told in docs/."""
