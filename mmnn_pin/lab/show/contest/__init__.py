"""What a contest shows: tables and targets as text, figures."""
