"""What judges: experiments, studies, the contest, the proof, and what shows their results."""
