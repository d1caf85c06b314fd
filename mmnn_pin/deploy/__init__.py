"""Out of the simulation: what takes a controller to a robot."""
