"""What judges: experiments, studies, whether a run learned (`psi`), and what shows their results."""
