"""Out of the simulation: what is learned from a real robot's recordings, and what goes back to it."""
