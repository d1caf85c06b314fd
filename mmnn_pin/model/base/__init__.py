"""The mobile base: wheels found in the description, the decision which base they make, and the motions it permits."""
