"""Out of the simulation: the controller on a machine of its own."""
