"""The robot as arrays: the compiled twin of its Pinocchio model."""
