"""Studies: many runs of an experiment under drawn and chosen settings, stored as they finish, tuned, judged."""
