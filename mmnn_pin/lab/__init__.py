"""The laboratory: experiments and studies, the judgement of learners, and the display of results."""
