"""Tables, figures, pages and files that are made of recordings."""
