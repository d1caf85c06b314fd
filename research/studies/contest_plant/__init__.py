"""A plant of its own for the contest, and the contest's controllers driven on it as on a robot."""
