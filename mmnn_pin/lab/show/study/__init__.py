"""What a study tells: a table, pictures, one page, and its rows for other programs."""
